"""Pictures as PNG files, written whole or not at all, if matplotlib is there."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from jaxgrasp.files.replace import replace_file
from jaxgrasp.validation.optional_library import optional_library

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 130


def check_matplotlib(subject: str = "the figure needs") -> None:
    """Raise ImportError with the pip command where matplotlib is not installed."""
    optional_library("matplotlib.figure", missing=f"{subject} matplotlib: pip install 'jaxgrasp[report]'")


def write_png(path: Path, figure: "Figure") -> None:
    """Write a figure."""
    replace_file(path, partial(figure.savefig, format="png", dpi=DPI))
