"""Arguments of ``jaxgrasp rank``."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Rank:
    """List the grasps of an evaluation by any column of its table."""

    results: tyro.conf.Positional[Path]
    """The folder that jaxgrasp evaluate wrote."""
    by: str
    """A column with numbers, as results.csv has them: B.margin_deg, ferrari-canny-l1.lower; or a measure of quality,
    which stands for its first column."""
    top: int = 20
    """Number of grasps."""
    smallest: bool = False
    """Start with the smallest number instead of the largest."""
