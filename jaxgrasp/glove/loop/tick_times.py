"""Timing statistics of a loop: histograms of lateness and work, overruns, largest lateness."""

from typing import Any

import numpy as np

EDGES = np.array([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]) * 1e-3
"""Edges of the histogram's bins [s]; the first bin begins at 0, the last has no end."""


class TickTimes:
    """Timing statistics of a loop with a fixed period."""

    def __init__(self, period: float) -> None:
        """Create statistics without any turns.

        Args:
            period: of its turns [s].
        """
        self.period = period
        self.late = np.zeros(len(EDGES) + 1, int)
        """Histogram of the turns by lateness, with the bins ``EDGES``."""
        self.busy = np.zeros(len(EDGES) + 1, int)
        """Histogram of the turns by working time, with the bins ``EDGES``."""
        self.overruns = 0
        """Number of turns that were not over when the next was due."""
        self.worst = 0.0
        """Largest lateness of a turn [s]."""

    def add(self, late: float, busy: float) -> None:
        """Count a turn by its lateness [s] and working time [s]."""
        self.late[np.searchsorted(EDGES, late)] += 1
        self.busy[np.searchsorted(EDGES, busy)] += 1
        self.overruns += late + busy > self.period
        self.worst = max(self.worst, late)

    def summary(self) -> dict[str, Any]:
        """Return the statistics as a JSON-serializable dictionary; times in milliseconds."""
        return {
            "period": 1e3 * self.period,
            "turns": int(self.late.sum()),
            "overruns": int(self.overruns),
            "worst": 1e3 * self.worst,
            "edges": (1e3 * EDGES).tolist(),
            "late": self.late.tolist(),
            "busy": self.busy.tolist(),
        }

    @staticmethod
    def text(summary: dict[str, Any]) -> str:
        """Format a summary as a line of text."""
        late = np.array(summary["late"])
        edges = [f"<{edge:g}" for edge in summary["edges"]] + [f">{summary['edges'][-1]:g}"]
        shares = [
            f"{edge} ms {share:.1%}" for edge, share in zip(edges, late / max(late.sum(), 1), strict=True) if share
        ]
        overruns = summary["overruns"] / max(summary["turns"], 1)
        return f"{summary['turns']} turns, {overruns:.1%} overruns, late by {', '.join(shares)}"
