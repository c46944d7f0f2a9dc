"""How punctual a loop is: lateness as a histogram, overruns, the worst."""

from typing import Any

import numpy as np

EDGES = np.array([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]) * 1e-3
"""Edges of the histogram's bins [s]; the first bin begins at 0, the last has no end."""


class TickTimes:
    """Counts of a loop that should turn at a period."""

    def __init__(self, period: float) -> None:
        """A loop that has not turned.

        Args:
            period: of its turns [s].
        """
        self.period = period
        self.late = np.zeros(len(EDGES) + 1, int)
        """Turns by how late they began."""
        self.busy = np.zeros(len(EDGES) + 1, int)
        """Turns by how long they worked."""
        self.overruns = 0
        """Turns that were not over when the next was due."""
        self.worst = 0.0
        """Latest beginning [s]."""

    def add(self, late: float, busy: float) -> None:
        """One turn."""
        self.late[np.searchsorted(EDGES, late)] += 1
        self.busy[np.searchsorted(EDGES, busy)] += 1
        self.overruns += late + busy > self.period
        self.worst = max(self.worst, late)

    def summary(self) -> dict[str, Any]:
        """For a report; times in milliseconds."""
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
        """A summary as a person reads it."""
        late = np.array(summary["late"])
        edges = [f"<{edge:g}" for edge in summary["edges"]] + [f">{summary['edges'][-1]:g}"]
        shares = [
            f"{edge} ms {share:.1%}" for edge, share in zip(edges, late / max(late.sum(), 1), strict=True) if share
        ]
        overruns = summary["overruns"] / max(summary["turns"], 1)
        return f"{summary['turns']} turns, {overruns:.1%} overruns, late by {', '.join(shares)}"
