"""The grasps that the report draws, each once, however many tables name it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from jaxgrasp.batch.rankings import case_title
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.report.look import text

LONGEST_TITLE = 36
"""Characters of a grasp's name that a button shows."""
WORTH_DROPPING = 8
"""Characters of a start that all names share, from which on it is dropped."""
SEPARATORS = "/\\_-:,. "
ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}"


@dataclass
class DrawnCases:
    """Cases in the order in which they are drawn; tables refer to them by buttons."""

    several: bool
    """True if grasps have several wrenches, so that each wrench must be named."""
    cases: list[dict] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    """Heading under which each case is listed."""
    _indices: dict[tuple[int, int], int] = field(default_factory=dict)

    def add(self, case: dict, group: str) -> int:
        """Add a case to a group and return its index; a case that is already drawn keeps its group and index."""
        key = (case["grasp"], case["wrench_number"])
        if key not in self._indices:
            self._indices[key] = len(self.cases)
            self.cases.append(case)
            self.groups.append(group)
        return self._indices[key]

    def index_of(self, grasp: int, wrench: int) -> int | None:
        return self._indices.get((grasp, wrench))

    def title(self, case: dict) -> str:
        return case_title(case, self.several)

    def pick(self, case: dict) -> str:
        """Return a button with the grasp's name, shortened, that shows it."""
        return self.pick_of(self._indices[case["grasp"], case["wrench_number"]], self.title(case))

    def pick_of(self, index: int, title: str) -> str:
        """Return a button that shows the case of this index; its title is short, and complete in the tooltip."""
        return pick(index, title, short_title(title, self.shared_start))

    @cached_property
    def shared_start(self) -> str:
        """Start that all titles share, as in an imported set; cached, so read it after the last `add`."""
        return shared_start([self.title(case) for case in self.cases])

    @staticmethod
    def of(summary: Summary) -> "DrawnCases":
        """Collect the cases to draw: failing grasps, both ends of each ranking, the highest prices of friction."""
        drawn = DrawnCases(summary.problems != summary.grasps)
        if summary.ranked is not None:
            for case in summary.ranked.examples.get(Reason.HARDER.name, []):
                drawn.add(case, Reason.HARDER.title)
            for reason, _ in summary.ranked.failing:
                for case in summary.ranked.examples.get(reason.name, []):
                    drawn.add(case, f"does not hold: {reason.title}")
            for name, ranking in summary.ranked.rankings.items():
                for end, cases in ranking.ends():
                    for case in cases:
                        drawn.add(case, f"{end} by {name}")
        for case in summary.worst:
            drawn.add(case, "highest price of friction")
        return drawn


def pick(index: int, title: str, shown: str | None = None) -> str:
    """Return a button that shows the case of this index; ``shown`` is a shorter title for the button."""
    if shown is None or shown == title:
        return f'<button type="button" class="pick" data-case="{index}">{text(title)}</button>'
    return f'<button type="button" class="pick" data-case="{index}" title="{text(title)}">{text(shown)}</button>'


def shared_start(titles: Sequence[str]) -> str:
    """Return the start that all titles share, up to the last separator of words; empty if it is short."""
    if len(set(titles)) < 2:
        return ""
    # The first and the last in order differ as early as any two do.
    pairs = zip(min(titles), max(titles), strict=False)
    start = min(titles)[: next((k for k, (first, last) in enumerate(pairs) if first != last), None)]
    start = start[: max((start.rfind(separator) for separator in SEPARATORS), default=-1) + 1]
    return start if len(start) >= WORTH_DROPPING else ""


def short_title(title: str, start: str = "") -> str:
    """Return a title without the start that all share, and without its middle where it is long: its end tells it."""
    short = ELLIPSIS + title[len(start) :] if start and title.startswith(start) else title
    if len(short) <= LONGEST_TITLE:
        return short
    head = LONGEST_TITLE // 3
    return short[:head] + ELLIPSIS + short[len(short) - (LONGEST_TITLE - head - 1) :]
