"""Schedule of a person's experiment, trial by trial: practice, then a session for each reference.

Balanced Latin squares, by which the order of conditions is counterbalanced over persons.
"""

import random
import re

from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures import Coin, Procedure
from jaxgrasp.psychophysics.trial import Presentation, Trial, intensity
from jaxgrasp.validation.checked import checked


@checked
def balanced_latin_square(count: int) -> list[list[int]]:
    """Return orders of ``count`` conditions, numbered from 0: a row for each person in turn.

    In all rows together each condition stands in each place equally often, and follows every other equally often.
    An even number of conditions takes as many rows, an odd one twice as many (Williams, Aust. J. Sci. Res. A 2, 1949).
    """
    zigzag = [(k + 1) // 2 if k % 2 else -k // 2 for k in range(count)]
    rows = [[(row + step) % count for step in zigzag] for row in range(count)]
    return rows if count % 2 == 0 else rows + [row[::-1] for row in rows]


def subject_index(subject: str) -> int:
    """Return the place of a person among all, from 0, by the number that the code ends in."""
    number = re.search(r"[0-9]+$", subject)
    if number is None or int(number.group()) == 0:
        raise ValueError(
            f"subject is {subject!r}, and the plan's orders are balanced over persons by number: expected a code that "
            "ends in one, from 1 on, such as S01"
        )
    return int(number.group()) - 1


class Schedule:
    """Schedule decided by the plan, the person's code, and the answers so far; call ``next`` and ``score`` in turn."""

    def __init__(self, plan: Plan, subject: str) -> None:
        """Begin the schedule of a person at the first trial.

        Args:
            plan: of the experiment.
            subject: code of the person.

        Raises:
            ValueError: for a code without a number, where orders are counterbalanced by these.
        """
        self._plan, self._subject = plan, subject
        rng = self._generator("sessions")
        references: list[float] = []
        conditions = self._ordered_conditions()
        for round_index in range(plan.session.sessions * len(conditions)):
            planned = list(plan.session.references)
            keys = [rng.random() for _ in planned]
            if plan.session.order == "balanced":
                square = balanced_latin_square(len(planned))
                # Sessions of one person go on through the rows, those of the next begin where they would.
                references += [planned[k] for k in square[(subject_index(subject) + round_index) % len(square)]]
            else:
                references += planned if plan.session.order == "given" else [r for _, r in sorted(zip(keys, planned))]
        self.references = references
        """References of the sessions, in their order."""
        per_round = len(plan.session.references) * plan.session.sessions
        self.conditions = [condition for condition in conditions for _ in range(per_round)]
        """Conditions of the sessions, in their order; empty texts where the plan has no factor within persons."""
        self._number, self._session = 1, 0
        self._procedure = self._begin()
        self._practice = self._practice_levels()

    def next(self) -> Trial | None:
        """Return the trial that is due, the same until it is scored; None after the last trial."""
        if self._practice:
            return self._trial(self._practice[0], is_practice=True)
        while self._session < len(self.references):
            presented = self._procedure.next()
            if presented is not None:
                return self._trial(presented, is_practice=False)
            self._session += 1
            if self._session < len(self.references):
                self._procedure = self._begin()
        return None

    def score(self, value: float) -> None:
        """Take the score of the trial that was due: 1 or 0 for a right or a wrong answer; of a setting, its level."""
        self._number += 1
        if self._practice:
            self._practice.pop(0)
        else:
            self._procedure.score(value)

    def _ordered_conditions(self) -> list[str]:
        """Return the conditions of a person in their order: all sessions of one, and then those of the next."""
        conditions = list(self._plan.within.conditions) or [""]
        if self._plan.session.order == "given" or len(conditions) == 1:
            return conditions
        if self._plan.session.order == "balanced":
            square = balanced_latin_square(len(conditions))
            return [conditions[k] for k in square[subject_index(self._subject) % len(square)]]
        self._generator("conditions").shuffle(conditions)
        return conditions

    def _begin(self) -> Procedure:
        return self._plan.procedure.begin(self._generator(f"session {self._session}"))

    def _practice_levels(self) -> list[Presentation]:
        coin = Coin(self._generator("practice"))
        level = self._plan.procedure.extremes()[1]
        # What is set always starts from the comparison, and comes second.
        is_choice = self._procedure.task == "choice"
        return [Presentation(level, coin.toss() and is_choice) for _ in range(self._plan.session.practice)]

    def _generator(self, purpose: str) -> random.Random:
        # A text seeds by its SHA-512, which is the same everywhere.
        return random.Random(f"{self._plan.seed}/{self._subject}/{purpose}")

    def _trial(self, presented: Presentation, *, is_practice: bool) -> Trial:
        reference = self.references[self._session]
        comparison = intensity(reference, presented.level)
        pair = (comparison, reference) if presented.comparison_first else (reference, comparison)
        position = (self._number, self._session + 1, presented.series + 1, is_practice)
        return Trial(*position, self._procedure.task, reference, presented.level, *pair, self.conditions[self._session])
