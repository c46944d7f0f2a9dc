"""Distributions that merge: counts in fixed bins, so that a stream of any length has quantiles."""

from dataclasses import dataclass

import numpy as np

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
