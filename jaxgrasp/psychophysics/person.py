"""Interface of a person who answers, and its implementation by a simulated observer."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Literal

import numpy as np

from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.trial import Rendered, Trial

Move = Literal["up", "down", "reference", "comparison", "done"]
"""Next action of a person who adjusts a stimulus."""


class Person(ABC):
    """Person who feels stimuli and answers."""

    observer: dict[str, float] | None = None
    """Parameters of a simulated observer, which the records keep; None for a person."""
    is_lost: Callable[[], bool] = staticmethod(lambda: False)
    """Function that returns whether the stimulus that is rendered has been lost; ``feel`` and ``adjust`` then return.
    """

    @abstractmethod
    def ask_consent(self, text: str) -> bool:
        """Show the text of the consent, and return True where the person agrees."""

    @abstractmethod
    def ask_question(self, question: str) -> str:
        """Return the answer to a question of the study, which may be empty."""

    @abstractmethod
    def show_instructions(self, text: str) -> None:
        """Show the instructions, and return when they have been read."""

    @abstractmethod
    def wait_until_ready(self, trial: Trial) -> None:
        """Wait until the person wants a trial to begin whose stimuli last as long as the plan says."""

    @abstractmethod
    def feel(self, trial: Trial, interval: int, duration_s: float) -> None:
        """Let the person feel the stimulus of interval 1 or 2.

        Returns after ``duration_s``, or, where that is 0, when the person has felt it; at once when it is lost.
        """

    @abstractmethod
    def pause(self, seconds: float) -> None:
        """Wait for ``seconds`` [s] while nothing is rendered."""

    @abstractmethod
    def announce_repeat(self, reason: str) -> None:
        """Tell the person that the trial does not count, with the reason, and will be asked again."""

    @abstractmethod
    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        """Return the answer which stimulus felt stronger, 1 or 2."""

    @abstractmethod
    def adjust(self, trial: Trial, setting: float) -> Move:
        """Return the person's next action at a setting; ``"done"`` where the stimulus is lost."""

    @abstractmethod
    def show_outcome(self, trial: Trial, is_right: bool) -> None:
        """Tell the person whether the answer was right."""

    @abstractmethod
    def take_break(self, n_done: int, max_trials: int) -> None:
        """Wait until a break is over, after ``n_done`` of at most ``max_trials`` trials."""


class SimulatedPerson(Person):
    """Observer whose answers follow from a seed, the person's code and the trial's number alone."""

    def __init__(self, observer: Observer, seed: int, subject: str, noise: Mapping[str, float] | None = None) -> None:
        """Create an observer.

        Args:
            observer: sensitivity of the person.
            seed: of the answers.
            subject: code of the person.
            noise: by condition, factor on the person's just noticeable differences; 1 where not given.

        Raises:
            ValueError: for a factor that is not a positive number.
        """
        self._noise = {} if noise is None else dict(noise)
        for condition, factor in self._noise.items():
            if not (np.isfinite(factor) and factor > 0):
                raise ValueError(f"noise of {condition} is {factor}: expected a positive number")
        self.observer = asdict(observer) | {f"noise_{name}": factor for name, factor in self._noise.items()}
        self._observer, self._seed, self._subject = observer, seed, subject
        self._adjusting, self._target = 0, 0.0
        self._before: Move = "done"

    def ask_consent(self, text: str) -> bool:
        return True

    def ask_question(self, question: str) -> str:
        return ""

    def show_instructions(self, text: str) -> None:
        return

    def wait_until_ready(self, trial: Trial) -> None:
        return

    def feel(self, trial: Trial, interval: int, duration_s: float) -> None:
        return

    def pause(self, seconds: float) -> None:
        return

    def announce_repeat(self, reason: str) -> None:
        return

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        first, second = (stimulus.felt_intensity for stimulus in rendered)
        return self._observer_in(trial.condition).choose(first, second, trial.number - 1, self._generator(trial))

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

    def show_outcome(self, trial: Trial, is_right: bool) -> None:
        return

    def take_break(self, n_done: int, max_trials: int) -> None:
        return

    def _observer_in(self, condition: str) -> Observer:
        factor = self._noise.get(condition, 1.0)
        if factor == 1.0:
            return self._observer
        return replace(self._observer, weber=factor * self._observer.weber, absolute=factor * self._observer.absolute)

    def _generator(self, trial: Trial) -> np.random.Generator:
        text = f"{self._seed}/{self._subject}/{trial.number}"
        return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big"))
