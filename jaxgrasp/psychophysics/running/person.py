"""Who answers: a person at a terminal implements this elsewhere; a simulated observer does here."""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import Literal

import numpy as np

from jaxgrasp.psychophysics.observer import Observer
from jaxgrasp.psychophysics.stimulus import Rendered
from jaxgrasp.psychophysics.trial import Trial

Move = Literal["up", "down", "reference", "comparison", "done"]
"""What a person who adjusts does next."""


class Person(ABC):
    """Feels stimuli and answers."""

    observer: dict[str, float] | None = None
    """Parameters of a simulated observer, whose answers are nobody's: the records say so."""

    @abstractmethod
    def consents(self, text: str) -> bool:
        """Read what is to be agreed to, and agree or not."""

    @abstractmethod
    def tells(self, question: str) -> str:
        """The answer to a question of the study's, which may be none."""

    @abstractmethod
    def instructed(self, text: str) -> None:
        """Read what is to be done; returns when it has been read."""

    @abstractmethod
    def ready(self, trial: Trial) -> None:
        """Before a trial whose stimuli last as long as the plan says; returns when the person wants it to begin."""

    @abstractmethod
    def feel(self, trial: Trial, interval: int, lasts: float) -> None:
        """Feel what is rendered in interval 1 or 2.

        Returns after ``lasts`` [s], or where that is 0 when the person has felt it.
        """

    @abstractmethod
    def waits(self, seconds: float) -> None:
        """Nothing is rendered; returns after so long [s]."""

    @abstractmethod
    def again(self, why: str) -> None:
        """Told that the trial does not count, and is asked again."""

    @abstractmethod
    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        """1 or 2: which one felt stronger."""

    @abstractmethod
    def adjust(self, trial: Trial, setting: float) -> Move:
        """What to do at a setting."""

    @abstractmethod
    def told(self, trial: Trial, right: bool) -> None:
        """Feedback."""

    @abstractmethod
    def rest(self, done: int, most: int) -> None:
        """A break; returns when it is over. ``most`` trials there are at most, and ``done`` of them are."""


class SimulatedPerson(Person):
    """An observer whose answers follow from a seed, the person's code and the trial's number alone."""

    def __init__(self, observer: Observer, seed: int, subject: str) -> None:
        self.observer = asdict(observer)
        self._observer, self._seed, self._subject = observer, seed, subject
        self._adjusting, self._target = 0, 0.0
        self._before: Move = "done"

    def consents(self, text: str) -> bool:
        return True

    def tells(self, question: str) -> str:
        return ""

    def instructed(self, text: str) -> None:
        return

    def ready(self, trial: Trial) -> None:
        return

    def feel(self, trial: Trial, interval: int, lasts: float) -> None:
        return

    def waits(self, seconds: float) -> None:
        return

    def again(self, why: str) -> None:
        return

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        first, second = (one.felt for one in rendered)
        return self._observer.choose(first, second, trial.number - 1, self._generator(trial))

    def adjust(self, trial: Trial, setting: float) -> Move:
        if trial.number != self._adjusting:
            self._adjusting = trial.number
            self._target = self._observer.match(trial.reference, trial.number - 1, self._generator(trial))
            self._before = "done"
        move: Move = "up" if setting < self._target else "down"
        # It stops where the next step would lead away again.
        if self._before not in ("done", move) or (move == "down" and setting <= 0):
            return "done"
        self._before = move
        return move

    def told(self, trial: Trial, right: bool) -> None:
        return

    def rest(self, done: int, most: int) -> None:
        return

    def _generator(self, trial: Trial) -> np.random.Generator:
        text = f"{self._seed}/{self._subject}/{trial.number}"
        return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big"))
