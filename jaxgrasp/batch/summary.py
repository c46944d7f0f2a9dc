"""Summary of an evaluation: counts and distributions that merge chunk by chunk.

Conversion of summaries to and from JSON, to resume an interrupted evaluation and to read a finished one.
"""

from dataclasses import dataclass, field

import numpy as np

from jaxgrasp.batch.chunk_statistics import WORST_CASES, LogHistogram, Ranked, Ranking, worst_cases
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.batch.qualities import QualitySummary, objective_gap
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.sources import OutwardNormals, outward_normals
from jaxgrasp.model.solution import METHODS, Route, Verdict, is_balanced, is_optimum

ANGLE_BINS = 90
SAMPLED_CONTACTS = 10_000


@dataclass
class MethodSummary:
    """Summary of a method over all problems."""

    verdicts: np.ndarray
    """Problems by verdict code."""
    steps: int
    """Newton steps in all."""
    routes: np.ndarray
    """Problems by the code of the pass that answered them, a [`jaxgrasp.Route`][]."""
    largest_residual: float
    """Largest residual of the answers that claim to balance the wrench."""
    smallest_margin: float
    """Smallest friction margin [rad] of the answers that claim to balance the wrench."""
    least_force_bound: float
    """Least ``force_bound`` of the problems without allowed forces [N]: none is proven to have none beyond it."""
    angles: np.ndarray
    """``(ANGLE_BINS, ANGLE_BINS)``: loaded contacts by slip angle (0 to pi) and friction angle (0 to pi / 2),
    in a sample of contacts."""

    def merged(self, summary: "MethodSummary") -> "MethodSummary":
        return MethodSummary(
            self.verdicts + summary.verdicts,
            self.steps + summary.steps,
            self.routes + summary.routes,
            max(self.largest_residual, summary.largest_residual),
            min(self.smallest_margin, summary.smallest_margin),
            min(self.least_force_bound, summary.least_force_bound),
            self.angles + summary.angles,
        )

    def count(self, *verdicts: Verdict) -> int:
        return int(sum(self.verdicts[v] for v in verdicts))


@dataclass
class MethodComparison:
    """Comparison of a closed form with its optimum, over the problems that have an optimum."""

    compared: int
    already_optimal: int
    price: LogHistogram
    """(F* - F) / F*: the share of the optimum's objective that is owed to friction."""
    distance: LogHistogram
    """|f - f*| / |f*| over all contacts of a problem."""
    violation: LogHistogram
    """Tangential force of the closed form beyond friction's limit, the worst contact's [N]."""

    def merged(self, comparison: "MethodComparison") -> "MethodComparison":
        return MethodComparison(
            self.compared + comparison.compared,
            self.already_optimal + comparison.already_optimal,
            self.price.merged(comparison.price),
            self.distance.merged(comparison.distance),
            self.violation.merged(comparison.violation),
        )


@dataclass
class Summary:
    """Summary of all methods, and comparison of each closed form with its optimum (keys "A" and "B")."""

    grasps: int
    contacts: int
    problems: int
    set_aside: int
    sizes: np.ndarray
    """Grasps by number of contacts."""
    methods: dict[str, MethodSummary]
    comparisons: dict[str, MethodComparison]
    worst: list[dict] = field(default_factory=list)
    """The problems whose closed form is furthest from its optimum, worst first, with their data."""
    qualities: dict[str, QualitySummary] = field(default_factory=dict)
    """Measures of quality that were asked for."""
    ranked: Ranked | None = None
    """Counts of problems by reason, and the best and the worst grasps."""
    outward: OutwardNormals = field(default_factory=OutwardNormals)
    """Grasps whose normals point away from the middle of their contacts."""

    def merged(self, summary: "Summary") -> "Summary":
        sizes = np.zeros(max(len(self.sizes), len(summary.sizes)), int)
        sizes[: len(self.sizes)] += self.sizes
        sizes[: len(summary.sizes)] += summary.sizes
        ranked = sorted(self.worst + summary.worst, key=lambda case: -case["price"])
        return Summary(
            self.grasps + summary.grasps,
            self.contacts + summary.contacts,
            self.problems + summary.problems,
            self.set_aside + summary.set_aside,
            sizes,
            {name: part.merged(summary.methods[name]) for name, part in self.methods.items()},
            {name: part.merged(summary.comparisons[name]) for name, part in self.comparisons.items()},
            ranked[:WORST_CASES],
            {name: part.merged(summary.qualities[name]) for name, part in self.qualities.items()},
            self.ranked.merged(summary.ranked) if self.ranked and summary.ranked else self.ranked or summary.ranked,
            self.outward.merged(summary.outward),
        )


def summarise(
    sets: ContactSets, results: dict[str, MethodResult], *, numbers: np.ndarray, set_aside: int = 0
) -> Summary:
    """Summarise a chunk, whose grasps have these ``numbers`` in the input."""
    comparisons: dict[str, MethodComparison] = {}
    worst: list[dict] = []
    for name in [method.name for method in METHODS.values() if not method.constrained]:
        optimum = METHODS[f"{name}-optimum"].name
        if name in results and optimum in results:
            comparison, price = _compare(sets, results[name], results[optimum])
            comparisons[name] = comparison
            if name == "B" or "B" not in results:
                worst = worst_cases(sets, results, price, name, numbers)
    return Summary(
        grasps=len(sets),
        contacts=len(sets.points),
        problems=len(sets) * sets.wrenches,
        set_aside=set_aside,
        sizes=np.bincount(sets.sizes),
        methods={name: _summarise_method(sets, result) for name, result in results.items()},
        comparisons=comparisons,
        worst=worst,
        outward=outward_normals(sets, numbers),
    )


def _summarise_method(sets: ContactSets, result: MethodResult) -> MethodSummary:
    answered = is_balanced(result.verdict)
    return MethodSummary(
        verdicts=np.bincount(result.verdict.ravel(), minlength=len(Verdict)),
        steps=int(result.steps.sum()),
        routes=np.bincount(result.route.ravel(), minlength=len(Route)),
        largest_residual=float(np.max(result.residual[answered], initial=0)),
        smallest_margin=float(np.min(result.margin[answered], initial=np.inf)),
        least_force_bound=float(np.min(result.force_bound[result.verdict == Verdict.INFEASIBLE], initial=np.inf)),
        angles=_angles(sets, result),
    )


def _angles(sets: ContactSets, result: MethodResult) -> np.ndarray:
    """Count a sample of contacts of answered problems, first wrench, by slip angle and friction angle."""
    answered = np.repeat(is_balanced(result.verdict[:, 0]), sets.sizes)
    chosen = np.flatnonzero(answered)[:: max(1, len(sets.points) // SAMPLED_CONTACTS)]
    force, normal = result.forces[chosen, 0].astype(float), sets.normals[chosen].astype(float)
    loaded = np.einsum("ci,ci->c", force, force) > 0
    along = np.einsum("ci,ci->c", force, normal)
    # Slip angle atan2(|n x f|, n.f); the friction angle is atan(mu).
    slip = np.arctan2(np.linalg.norm(np.cross(normal, force), axis=1), along)[loaded]
    friction = np.arctan(sets.friction[chosen].astype(float))[loaded]
    cell = ANGLE_BINS * _bin(slip, np.pi) + _bin(friction, np.pi / 2)
    return np.bincount(cell, minlength=ANGLE_BINS**2).reshape(ANGLE_BINS, ANGLE_BINS)


def _bin(angle: np.ndarray, largest: float) -> np.ndarray:
    return np.minimum((angle * (ANGLE_BINS / largest)).astype(int), ANGLE_BINS - 1)


def _compare(sets: ContactSets, closed: MethodResult, optimum: MethodResult) -> tuple[MethodComparison, np.ndarray]:
    """Compare a closed form with its optimum; return the comparison and prices ``(N, W)``, -inf without optimum."""
    solved = is_optimum(optimum.verdict)
    already = optimum.verdict == Verdict.CLOSED_FORM_OPTIMAL
    price = objective_gap(closed.objective, optimum.objective, optimum.verdict)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = _length_by_problem(sets, closed.forces, optimum.forces)
        distance = np.where(already, 0, apart / _length_by_problem(sets, optimum.forces))
    comparison = MethodComparison(
        compared=int(solved.sum()),
        already_optimal=int(already.sum()),
        price=LogHistogram.of(np.maximum(price[solved], 0)),
        distance=LogHistogram.of(distance[solved]),
        violation=LogHistogram.of(np.where(already, 0, closed.violation)[solved]),
    )
    return comparison, np.where(solved, price, -np.inf)


def _length_by_problem(sets: ContactSets, forces: np.ndarray, others: np.ndarray | None = None) -> np.ndarray:
    """Compute the norm of all forces of each problem, or of their differences from ``others``, ``(N, W)``."""
    square = np.zeros(forces.shape[:-1], forces.dtype)
    # A component at a time: of millions of grasps all of the forces once more are gigabytes.
    for i in range(3):
        apart = forces[..., i] if others is None else forces[..., i] - others[..., i]
        square += apart * apart
    return np.sqrt(np.add.reduceat(square, sets.offsets[:-1], axis=0))


_HISTOGRAMS = ("price", "distance", "violation")


def to_json(summary: Summary) -> dict:
    return {
        "grasps": summary.grasps,
        "contacts": summary.contacts,
        "problems": summary.problems,
        "set_aside": summary.set_aside,
        "sizes": summary.sizes.tolist(),
        "methods": {name: _method_to_json(method) for name, method in summary.methods.items()},
        "comparisons": {name: _comparison_to_json(c) for name, c in summary.comparisons.items()},
        "worst": summary.worst,
        "qualities": {name: quality.to_json() for name, quality in summary.qualities.items()},
        "ranked": summary.ranked and _ranked_to_json(summary.ranked),
        "outward_normals": summary.outward._asdict(),
    }


def from_json(data: dict) -> Summary:
    fields = {name: data[name] for name in ("grasps", "contacts", "problems", "set_aside", "worst")}
    return Summary(
        **fields,
        sizes=np.array(data["sizes"], int),
        methods={name: _method_from_json(method) for name, method in data["methods"].items()},
        comparisons={name: _comparison_from_json(c) for name, c in data["comparisons"].items()},
        qualities={name: QualitySummary.from_json(quality) for name, quality in data["qualities"].items()},
        ranked=data["ranked"] and _ranked_from_json(data["ranked"]),
        outward=_outward_from_json(data["outward_normals"]),
    )


def _outward_from_json(data: dict) -> OutwardNormals:
    return OutwardNormals(data["away"], data["decided"], tuple(data["names"]))


def _ranked_to_json(ranked: Ranked) -> dict:
    return {
        "judge": ranked.judge,
        "reasons": {reason.name: int(ranked.counts[reason]) for reason in Reason},
        "examples": ranked.examples,
        "rankings": {name: {"best": ranking.best, "worst": ranking.worst} for name, ranking in ranked.rankings.items()},
    }


def _ranked_from_json(data: dict) -> Ranked:
    return Ranked(
        data["judge"],
        np.array([data["reasons"][reason.name] for reason in Reason]),
        data["examples"],
        {name: Ranking(**ends) for name, ends in data["rankings"].items()},
    )


def _cells_to_json(cells: np.ndarray) -> list | dict:
    """Return counts as rows, or where most are zero as shape and counts by the cell's number, row by row."""
    used = np.flatnonzero(cells)
    if len(used) > cells.size // 4:
        return cells.tolist()
    return {"shape": list(cells.shape), "counts": {str(cell): int(cells.flat[cell]) for cell in used.tolist()}}


def _cells_from_json(data: list | dict) -> np.ndarray:
    if isinstance(data, list):
        return np.array(data, int)
    cells = np.zeros(data["shape"], int)
    for cell, count in data["counts"].items():
        cells.flat[int(cell)] = count
    return cells


def _method_to_json(method: MethodSummary) -> dict:
    margin, bound = method.smallest_margin, method.least_force_bound
    return {
        "verdicts": {verdict.name: int(method.verdicts[verdict]) for verdict in Verdict},
        "steps": method.steps,
        "routes": {route.name: int(method.routes[route]) for route in Route},
        "largest_residual": method.largest_residual,
        # JSON has no infinity; a method without a loaded contact has no margin.
        "smallest_margin": margin if np.isfinite(margin) else None,
        "least_force_bound": bound if np.isfinite(bound) else None,
        "angles": _cells_to_json(method.angles),
    }


def _method_from_json(data: dict) -> MethodSummary:
    margin, bound = data["smallest_margin"], data["least_force_bound"]
    return MethodSummary(
        verdicts=np.array([data["verdicts"][verdict.name] for verdict in Verdict]),
        steps=data["steps"],
        routes=np.array([data["routes"][route.name] for route in Route]),
        largest_residual=data["largest_residual"],
        smallest_margin=np.inf if margin is None else margin,
        least_force_bound=np.inf if bound is None else bound,
        angles=_cells_from_json(data["angles"]),
    )


def _comparison_to_json(comparison: MethodComparison) -> dict:
    counts = {"compared": comparison.compared, "already_optimal": comparison.already_optimal}
    return counts | {name: getattr(comparison, name).to_json() for name in _HISTOGRAMS}


def _comparison_from_json(data: dict) -> MethodComparison:
    histograms = {name: LogHistogram.from_json(data[name]) for name in _HISTOGRAMS}
    return MethodComparison(data["compared"], data["already_optimal"], **histograms)
