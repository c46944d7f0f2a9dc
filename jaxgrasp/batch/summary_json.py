"""Conversion of summaries to and from JSON, to resume an interrupted evaluation and to read a finished one."""

import numpy as np

from jaxgrasp.batch.histogram import LogHistogram
from jaxgrasp.batch.qualities import QualitySummary
from jaxgrasp.batch.rankings import Ranked, Ranking
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.sources import OutwardNormals
from jaxgrasp.batch.summary import MethodComparison, MethodSummary, Summary
from jaxgrasp.model.solution import Route, Verdict

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
