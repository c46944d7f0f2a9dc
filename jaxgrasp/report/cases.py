"""The grasps that the report draws, each once, however many tables name it."""

from dataclasses import dataclass, field

from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.batch.worst import case_title
from jaxgrasp.report.look import text


@dataclass
class DrawnCases:
    """Cases in the order in which they are drawn; tables refer to them by buttons."""

    several: bool
    """Whether grasps have several wrenches, so that each must be named."""
    cases: list[dict] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    """Under which heading each is offered."""
    _places: dict[tuple[int, int], int] = field(default_factory=dict)

    def add(self, case: dict, group: str) -> int:
        """The case's place; one that another group has already keeps the place that it has there."""
        key = (case["grasp"], case["wrench_number"])
        if key not in self._places:
            self._places[key] = len(self.cases)
            self.cases.append(case)
            self.groups.append(group)
        return self._places[key]

    def place(self, grasp: int, wrench: int) -> int | None:
        return self._places.get((grasp, wrench))

    def title(self, case: dict) -> str:
        return case_title(case, self.several)

    def pick(self, case: dict) -> str:
        """A button with the grasp's name that shows it."""
        return pick(self._places[case["grasp"], case["wrench_number"]], self.title(case))

    @staticmethod
    def of(summary: Summary) -> "DrawnCases":
        """Those that do not hold, the ends of each order, and where closed forms are furthest from their optima."""
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


def pick(place: int, title: str) -> str:
    """A button that shows the case of this place."""
    return f'<button type="button" class="pick" data-case="{place}">{text(title)}</button>'
