"""Person whose trials are shown: the page shows each question before the person is asked."""

import math

from jaxgrasp.psychophysics.running.person import Move, Person
from jaxgrasp.psychophysics.stimulus import Rendered
from jaxgrasp.psychophysics.trial import Trial
from jaxgrasp.view.trial_words import Phase
from jaxgrasp.view.view_slots import TrialNow


class ViewedPerson(Person):
    """Wrapper of a person that passes on the answers and updates the text of the pages."""

    def __init__(self, person: Person, most: int):
        """Wrap a person; ``most`` is the largest number of trials."""
        self.observer = person.observer
        self._person, self._most = person, most
        self.now = TrialNow()

    def consents(self, text: str) -> bool:
        return self._person.consents(text)

    def tells(self, question: str) -> str:
        return self._person.tells(question)

    def instructed(self, text: str) -> None:
        self._person.instructed(text)

    def ready(self, trial: Trial) -> None:
        self._person.ready(trial)

    def feel(self, trial: Trial, interval: int, lasts: float) -> None:
        self._begins(Phase.FEELS, trial, float(interval))
        self._person.feel(trial, interval, lasts)

    def waits(self, seconds: float) -> None:
        self._person.waits(seconds)

    def again(self, why: str) -> None:
        self._person.again(why)

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        self._begins(Phase.CHOOSES, trial)
        choice = self._person.choose(trial, rendered)
        right = float(choice == trial.stronger)
        self.now = self.now._replace(phase=Phase.WAITS, answered=self.now.answered + 1, right=self.now.right + right)
        return choice

    def adjust(self, trial: Trial, setting: float) -> Move:
        self._begins(Phase.ADJUSTS, trial, setting=setting)
        return self._person.adjust(trial, setting)

    def told(self, trial: Trial, right: bool) -> None:
        self._person.told(trial, right)

    def rest(self, done: int, most: int) -> None:
        self.now = self.now._replace(phase=Phase.RESTS)
        self._person.rest(done, most)

    def _begins(self, phase: Phase, trial: Trial, interval: float = math.nan, setting: float = math.nan) -> None:
        if trial.task == "setting" and math.isnan(setting):
            setting = trial.second
        self.now = self.now._replace(
            phase=float(phase),
            number=float(trial.number),
            most=float(self._most),
            interval=interval,
            first=trial.first,
            second=trial.second,
            setting=setting,
        )
