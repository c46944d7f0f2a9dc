"""Statistics of many grasps that merge chunk by chunk: histograms, the best and worst grasps, and examples of failures.

Histograms have fixed bins, so that a stream of any length has quantiles. Extremes and examples hold the data to draw
single problems.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.batch.reasons import HELD, Reason, judge
from jaxgrasp.model.solution import is_balanced
from jaxgrasp.quality.measures import Columns

LOWEST, HIGHEST, PER_DECADE = -16, 6, 20
EDGES = 10.0 ** np.linspace(LOWEST, HIGHEST, (HIGHEST - LOWEST) * PER_DECADE + 1)


@dataclass
class LogHistogram:
    """Counts of values >= 0 in bins of a twentieth of a decade; anything below 1e-16 counts as zero."""

    counts: np.ndarray
    zeros: int = 0
    largest: float = 0.0

    @classmethod
    def of(cls, values: np.ndarray) -> "LogHistogram":
        values = np.asarray(values, float)
        positive = values[values >= EDGES[0]]
        counts, _ = np.histogram(np.minimum(positive, EDGES[-1]), EDGES)
        return cls(counts, len(values) - len(positive), float(values.max(initial=0)))

    @property
    def total(self) -> int:
        return self.zeros + int(self.counts.sum())

    def merged(self, histogram: "LogHistogram") -> "LogHistogram":
        return LogHistogram(
            self.counts + histogram.counts, self.zeros + histogram.zeros, max(self.largest, histogram.largest)
        )

    def quantile(self, share: float) -> float:
        """Return the value below which a ``share`` of all values lies, to half a bin (6%); the largest is exact."""
        rank = share * self.total
        if self.total == 0 or rank <= self.zeros:
            return 0.0
        if share == 1:
            return self.largest
        bin_ = int(np.searchsorted(self.zeros + np.cumsum(self.counts), rank))
        return min(float(np.sqrt(EDGES[bin_] * EDGES[bin_ + 1])), self.largest)

    def to_json(self) -> dict:
        used = np.flatnonzero(self.counts)
        return {
            "zeros": self.zeros,
            "largest": self.largest,
            "bins": {str(int(i)): int(self.counts[i]) for i in used},
        }

    @classmethod
    def from_json(cls, data: dict) -> "LogHistogram":
        counts = np.zeros(len(EDGES) - 1, int)
        for index, count in data["bins"].items():
            counts[int(index)] = count
        return cls(counts, data["zeros"], data["largest"])


WORST_CASES = 10


def worst_cases(
    sets: ContactSets, results: dict[str, MethodResult], price: np.ndarray, method: str, numbers: np.ndarray
) -> list[dict]:
    """Return the problems of highest positive price, worst first; ``numbers`` are those of the grasps in the input."""
    flat = price.ravel()
    order = np.argsort(-flat, kind="stable")[:WORST_CASES]
    chosen = order[flat[order] > 0]
    cases = cases_of(sets, results, method, chosen, numbers)
    return [case | {"price": float(flat[problem])} for case, problem in zip(cases, chosen, strict=True)]


def cases_of(
    sets: ContactSets,
    results: dict[str, MethodResult],
    method: str,
    problems: Iterable[int] | np.ndarray,
    numbers: np.ndarray,
) -> list[dict]:
    """Return the data of ``problems``, flat indices in ``(N, W)``, with the answers of ``method`` and its optimum.

    An answer is None where its method was not asked for, or has no forces that balance the wrench.
    """
    closed, optimum = results.get(method), results.get(f"{method}-optimum")
    cases = []
    for problem in problems:
        grasp, wrench = divmod(int(problem), sets.wrenches)
        contacts = slice(sets.offsets[grasp], sets.offsets[grasp + 1])
        cases.append(
            {
                "grasp": int(numbers[grasp]),
                "wrench_number": wrench,
                "method": method,
                "labels": {name: str(values[grasp]) for name, values in sets.labels.items()},
                "price": None,
                "margin": None if closed is None else finite_or_none(closed.margin[grasp, wrench]),
                "violation": None if closed is None else finite_or_none(closed.violation[grasp, wrench]),
                "points": sets.points[contacts].tolist(),
                "normals": sets.normals[contacts].tolist(),
                "friction": sets.friction[contacts].tolist(),
                "squeeze": sets.squeeze[contacts].tolist(),
                "wrench": sets.wrench[grasp, wrench].tolist(),
                "closed": _forces(closed, contacts, grasp, wrench),
                "optimum": _forces(optimum, contacts, grasp, wrench),
            }
        )
    return cases


def case_title(case: dict, several: bool = False) -> str:
    """Return a grasp's name, or its number if it has no name; with the number of its wrench if ``several``."""
    title = case["labels"].get("name") or f"grasp {case['grasp']}"
    return f"{title}, wrench {case['wrench_number']}" if several else title


def finite_or_none(value: float | np.floating) -> float | None:
    """Convert a number for JSON, which has no infinity: a finite float, or else None."""
    return float(value) if math.isfinite(value) else None


def _forces(result: MethodResult | None, contacts: slice, grasp: int, wrench: int) -> list | None:
    if result is None or not is_balanced(result.verdict[grasp, wrench]):
        return None
    return result.forces[contacts, wrench].tolist()


RANKED = 5
"""Number of the best grasps, and of the worst."""
EXAMPLES = 3
"""Number of examples of grasps that fail, for each reason."""
MARGIN, LEAST_FRICTION = "friction margin", "least friction"
SMALLER_IS_BETTER = (LEAST_FRICTION,)
RADIUS = "N of wrench per N of normal force"
UNITS = {
    LEAST_FRICTION: "times its friction",
    "force-closure": f"margin, {RADIUS}",
    "ferrari-canny-l1": RADIUS,
    "ferrari-canny-linf": RADIUS,
    "min-weight": "share of the weight of an even one",
    "least-singular-value": "of the grasp matrix",
    "volume": "of the grasp matrix",
    "isotropy": "0 to 1",
    "task-ball-l1": "times the ellipsoid",
    "task-ball-linf": "times the ellipsoid",
    "task-margin": "times the task's wrench",
    "hold-probability": "0 to 1",
}
"""Units of the values of each order except margins, which are angles."""
NOTHING_LEFT = 1e-12
"""Limit of rounding: smaller values are shown as 0."""


def ranking_title(name: str) -> str:
    """Return the name of an order with the unit of its values."""
    return f"{name} [{UNITS[name]}]" if name in UNITS else name


def without_rounding(value: float) -> float:
    """Return a value of an order for display: 0 in place of values that are rounding."""
    return 0.0 if abs(value) < NOTHING_LEFT else value


@dataclass
class Ranking:
    """The two ends of an order: cases as ``cases_of`` makes them, with their ``value``."""

    best: list[dict] = field(default_factory=list)
    """Best first, of those that hold."""
    worst: list[dict] = field(default_factory=list)
    """Worst first, including those that do not hold."""

    def ends(self) -> tuple[tuple[str, list[dict]], ...]:
        """Return both ends with their names; a case among the best is left out of the worst."""
        best = {(case["grasp"], case["wrench_number"]) for case in self.best}
        worst = [case for case in self.worst if (case["grasp"], case["wrench_number"]) not in best]
        return ("best", self.best), ("worst", worst)

    def merged(self, ranking: "Ranking", sign: float) -> "Ranking":
        """Merge two rankings; ``sign`` is 1 where larger values are better, and -1 where smaller are."""
        best = sorted(self.best + ranking.best, key=lambda case: -sign * case["value"])
        worst = sorted(self.worst + ranking.worst, key=lambda case: sign * case["value"])
        return Ranking(best[:RANKED], worst[:RANKED])


@dataclass
class Ranked:
    """Counts of problems by reason, examples of failures, and rankings."""

    judge: str
    """Name of the method that decides which grasps hold."""
    counts: np.ndarray
    """Problems by code of Reason."""
    examples: dict[str, list[dict]]
    """Examples of each Reason, by its name, in the order of the input."""
    rankings: dict[str, Ranking]
    """Rankings by ``friction margin`` of a closed form [rad], ``least friction`` and measures of quality."""

    @property
    def holds(self) -> int:
        """Problems that hold as they squeeze."""
        return int(self.counts[Reason.HOLDS])

    @property
    def harder(self) -> int:
        """Problems that hold if they squeeze harder."""
        return int(self.counts[Reason.HARDER])

    @property
    def failing(self) -> list[tuple[Reason, int]]:
        """Reasons of grasps that do not hold with their counts, the most frequent first."""
        failures = [
            (reason, int(self.counts[reason])) for reason in Reason if reason not in HELD and self.counts[reason]
        ]
        return sorted(failures, key=lambda pair: -pair[1])

    def merged(self, ranked: "Ranked") -> "Ranked":
        names = dict.fromkeys([*self.examples, *ranked.examples])
        return Ranked(
            self.judge,
            self.counts + ranked.counts,
            {name: (self.examples.get(name, []) + ranked.examples.get(name, []))[:EXAMPLES] for name in names},
            {name: ranking.merged(ranked.rankings[name], _sign(name)) for name, ranking in self.rankings.items()},
        )


def rank(
    sets: ContactSets,
    results: dict[str, MethodResult],
    why: np.ndarray,
    quality: Columns,
    least_friction: np.ndarray | None,
    numbers: np.ndarray,
    squeeze_factor: np.ndarray | None = None,
) -> Ranked:
    """Count the reasons ``why (N, W)`` of a chunk and rank its grasps, which have these ``numbers`` in the input."""
    name = judge(results)
    examples = {
        reason.name: cases_of(sets, results, name[0], np.flatnonzero(why.ravel() == reason)[:EXAMPLES], numbers)
        for reason in Reason
        if reason and (why == reason).any()
    }
    if squeeze_factor is not None and Reason.HARDER.name in examples:
        factors = squeeze_factor.ravel()[np.flatnonzero(why.ravel() == Reason.HARDER)[:EXAMPLES]]
        for case, factor in zip(examples[Reason.HARDER.name], factors.tolist(), strict=True):
            case["squeeze_factor"] = factor
    rankings, holds = {}, np.isin(why.ravel(), HELD)
    for label, (method, values) in _orders(sets, results, quality, least_friction, name[0]).items():
        flat = np.asarray(values, float).ravel() * _sign(label)
        ranked = np.flatnonzero(np.isfinite(flat))
        ranked = ranked[np.argsort(flat[ranked], kind="stable")]
        # Of equal ones the first of the input comes first at either end.
        down = ranked[np.argsort(-flat[ranked], kind="stable")]
        ends = (down[holds[down]][:RANKED], ranked[:RANKED])
        best, worst = (
            [
                case | {"value": float(flat[problem] * _sign(label))}
                for case, problem in zip(cases_of(sets, results, method, end, numbers), end, strict=True)
            ]
            for end in ends
        )
        rankings[label] = Ranking(best, worst)
    return Ranked(name, np.bincount(why.ravel(), minlength=len(Reason)), examples, rankings)


def _orders(
    sets: ContactSets,
    results: dict[str, MethodResult],
    quality: Columns,
    least_friction: np.ndarray | None,
    judge_name: str,
) -> dict[str, tuple[str, np.ndarray]]:
    """Return for each order the method that is drawn beside it, and a value for each problem ``(N, W)``, or NaN."""
    orders: dict[str, tuple[str, np.ndarray]] = {}
    # An optimum that a cone holds has a margin of zero by its nature: margins compare closed forms.
    closed = next((name for name in ("B", "A") if name in results), None)
    if closed is not None:
        answer = results[closed]
        orders[MARGIN] = closed, np.where(is_balanced(answer.verdict), answer.margin, np.nan)
    if least_friction is not None:
        orders[LEAST_FRICTION] = judge_name, least_friction
    for measure in dict.fromkeys(name.split(".")[0] for name in quality):
        columns = [name for name in quality if name.startswith(f"{measure}.")]
        values = quality[next((name for name in columns if quality[name].dtype.kind == "f"), columns[0])]
        # A grasp has one quality, whatever its wrenches: it stands with its first.
        by_problem = np.full((len(sets), sets.wrenches), np.nan)
        by_problem[:, 0] = values
        orders[measure] = judge_name, by_problem
    return orders


def _sign(name: str) -> float:
    return -1.0 if name in SMALLER_IS_BETTER else 1.0
