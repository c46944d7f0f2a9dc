"""Measures of quality of contact sets, and their summaries."""

from dataclasses import dataclass

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.histogram import LogHistogram
from jaxgrasp.force.least_friction import least_friction
from jaxgrasp.model.progress import Progress
from jaxgrasp.quality.in_turn import TOGETHER
from jaxgrasp.quality.measures import UNDECIDED, Columns, Measure, MeasuredGrasps


def measure_all(measures: tuple[Measure, ...], sets: ContactSets, progress: Progress | None = None) -> Columns:
    """Compute every measure of every grasp: arrays ``(N,)`` by ``MEASURE.COLUMN``.

    Grasps are measured a few hundred at a time; ``progress`` is told the number of each part.
    """
    if not measures:
        return {}
    width, parts = max(1, sets.largest), []
    for start in range(0, max(len(sets), 1), TOGETHER):
        subset = sets.rows(slice(start, start + TOGETHER))
        measured = MeasuredGrasps(subset.padded(width), subset.wrench, subset.limits(width))
        parts.append(
            {
                f"{measure.name}.{column}": values
                for measure in measures
                for column, values in measure.columns(measured).items()
            }
        )
        if progress is not None:
            progress(len(subset))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def least_friction_of(sets: ContactSets) -> np.ndarray:
    """Compute the least factor on their friction with which sets hold, ``(N, W)``; +inf where no friction suffices.

    The total of normal forces is that of the squeezing forces of the hand.
    """
    grasp = sets.padded(max(1, sets.largest))
    factors = [np.asarray(least_friction(grasp, sets.wrench[:, k], "uniform")) for k in range(sets.wrenches)]
    return np.stack(factors, 1)


@dataclass
class QualitySummary:
    """Summary of a measure over all grasps."""

    values: LogHistogram
    """Distribution of the measure's first column; numbers below zero count as zero."""
    undecided: int = 0

    def merged(self, summary: "QualitySummary") -> "QualitySummary":
        return QualitySummary(self.values.merged(summary.values), self.undecided + summary.undecided)

    def to_json(self) -> dict:
        return {"values": self.values.to_json(), "undecided": self.undecided}

    @classmethod
    def from_json(cls, data: dict) -> "QualitySummary":
        return cls(LogHistogram.from_json(data["values"]), data["undecided"])


def summarise_qualities(measures: tuple[Measure, ...], columns: Columns) -> dict[str, QualitySummary]:
    """Summarise the measures of a chunk, by the measures' names."""
    summaries = {}
    for measure in measures:
        values = next(array for name, array in columns.items() if name.startswith(f"{measure.name}."))
        unknown = values == UNDECIDED if values.dtype == np.int8 else np.zeros(len(values), bool)
        summaries[measure.name] = QualitySummary(LogHistogram.of(np.maximum(values, 0)), int(unknown.sum()))
    return summaries


def quality_line(name: str, summary: QualitySummary) -> str:
    """Format the summary of a measure as a line of text."""
    values = summary.values
    if name == "force-closure":
        closed = int(values.counts.sum())
        text = f"{name:22}{_share(closed, values.total)} closed"
        return text + (f", {_share(summary.undecided, values.total)} undecided" if summary.undecided else "")
    # Those of a histogram are known to half of its bins; the largest is exact.
    quantiles = [f"{label} ~{values.quantile(share):.2g}" for label, share in _QUANTILES]
    joined = "  ".join([*quantiles, f"largest {values.quantile(1.0):.3g}"])
    return f"{name:22}{joined}" + (f"  {_share(values.zeros, values.total)} none" if values.zeros else "")


_QUANTILES = (("5%", 0.05), ("median", 0.5), ("95%", 0.95))


def _share(count: int, total: int) -> str:
    return f"{100 * count / max(1, total):.1f} %"
