"""Person whose trials are shown: the page shows each question before the person is asked."""

import math

from jaxgrasp.psychophysics.person import Move, Person
from jaxgrasp.psychophysics.trial import Rendered, Trial
from jaxgrasp.view.trial_words import Phase
from jaxgrasp.view.view_slots import TrialState


class ViewedPerson(Person):
    """Wrapper of a person that passes on the answers and updates the text of the pages."""

    def __init__(self, person: Person, max_trials: int):
        """Wrap a person; ``most`` is the largest number of trials."""
        self.observer = person.observer
        self._person, self._max_trials = person, max_trials
        self.state = TrialState()

    def ask_consent(self, text: str) -> bool:
        return self._person.ask_consent(text)

    def ask_question(self, question: str) -> str:
        return self._person.ask_question(question)

    def show_instructions(self, text: str) -> None:
        self._person.show_instructions(text)

    def wait_until_ready(self, trial: Trial) -> None:
        self._person.wait_until_ready(trial)

    def feel(self, trial: Trial, interval: int, duration_s: float) -> None:
        self._begins(Phase.FEELS, trial, float(interval))
        self._person.feel(trial, interval, duration_s)

    def pause(self, seconds: float) -> None:
        self._person.pause(seconds)

    def announce_repeat(self, reason: str) -> None:
        self._person.announce_repeat(reason)

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        self._begins(Phase.CHOOSES, trial)
        choice = self._person.choose(trial, rendered)
        right = float(choice == trial.stronger)
        self.state = self.state._replace(
            phase=Phase.WAITS, answered=self.state.answered + 1, right=self.state.right + right
        )
        return choice

    def adjust(self, trial: Trial, setting: float) -> Move:
        self._begins(Phase.ADJUSTS, trial, setting=setting)
        return self._person.adjust(trial, setting)

    def show_outcome(self, trial: Trial, is_right: bool) -> None:
        self._person.show_outcome(trial, is_right)

    def take_break(self, n_done: int, max_trials: int) -> None:
        self.state = self.state._replace(phase=Phase.RESTS)
        self._person.take_break(n_done, max_trials)

    def _begins(self, phase: Phase, trial: Trial, interval: float = math.nan, setting: float = math.nan) -> None:
        if trial.task == "setting" and math.isnan(setting):
            setting = trial.second
        self.state = self.state._replace(
            phase=float(phase),
            number=float(trial.number),
            most=float(self._max_trials),
            interval=interval,
            first=trial.first,
            second=trial.second,
            setting=setting,
        )
