"""Shared look of the report: a colour for each method and verdict, and numbers formatted for reading.

Pictures as PNG files, written whole or not at all, if matplotlib is there.
"""

import math
from collections.abc import Iterable
from functools import partial
from html import escape
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

from jaxgrasp.files.replace import replace_file
from jaxgrasp.grip.monitor import Hold, Touch
from jaxgrasp.model.solution import METHODS, Verdict
from jaxgrasp.validation.optional_library import optional_library

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The palette of Okabe and Ito, safe for colour-blind readers. Closed forms are warm, optima are cool: where the two
# are drawn together, warm is what may slip.
METHOD_COLOURS = {"A": "#E69F00", "B": "#D55E00", "A-optimum": "#56B4E9", "B-optimum": "#0072B2"}
VERDICT_COLOURS = {
    Verdict.CLOSED_FORM_OPTIMAL: "#009E73",
    Verdict.OPTIMAL: "#8FD3BC",
    Verdict.OUTSIDE_CONES: "#CC79A7",
    Verdict.INFEASIBLE: "#5A5A5A",
    Verdict.NO_CONTACTS: "#BDBDBD",
    Verdict.NOT_CONVERGED: "#F0E442",
    Verdict.INVALID_DATA: "#000000",
    Verdict.FEASIBLE: "#56B4E9",
}
VERDICT_TITLES = {
    Verdict.CLOSED_FORM_OPTIMAL: "closed form, inside every cone",
    Verdict.OPTIMAL: "optimum, held by a cone",
    Verdict.OUTSIDE_CONES: "balances, but slips or pulls",
    Verdict.INFEASIBLE: "no allowed forces exist",
    Verdict.NO_CONTACTS: "no contact can carry a force",
    Verdict.NOT_CONVERGED: "not decided",
    Verdict.INVALID_DATA: "invalid data",
    Verdict.FEASIBLE: "allowed, but perhaps not the optimum",
}
TOUCH_COLOURS = {Touch.HOLDS: "#009E73", Touch.SLIDES: "#D55E00", Touch.PULLS: "#CC79A7"}
HOLD_COLOURS = {Hold.STABLE: "#009E73", Hold.SLIPPING: "#D55E00", Hold.LOST: "#5A5A5A"}
# Colours that say nothing about how a contact holds.
FINGER_COLOURS = ("#1c2530", "#E69F00", "#56B4E9", "#0072B2", "#8a6d3b")
SKIN_COLOUR, OBJECT_COLOUR, TABLE_COLOUR = "#e3c4a8", "#9fb0c3", "#cfc9bd"
INK, MUTED, GRID = "#1c2530", "#5b6673", "#e3e7ec"
WRENCH_COLOUR = "#222222"
NOTHING = "\N{EN DASH}"


def finger_colours(fingers: Iterable[str]) -> dict[str, str]:
    """Assign a colour to each finger, in the order of first appearance."""
    return dict(zip(dict.fromkeys(fingers), cycle(FINGER_COLOURS), strict=False))


def method_title(name: str) -> str:
    """Return a method's title: "closed form A" for ``A``, "optimum A" for ``A-optimum``."""
    return f"{'optimum' if METHODS[name].constrained else 'closed form'} {name[0]}"


def format_count(count: int) -> str:
    """Format a count with a narrow space between thousands."""
    return f"{count:,}".replace(",", "\u202f")


def counted(count: int, unit: str) -> str:
    """Format a count with its unit: "1 grasp", "2 grasps"."""
    return f"{format_count(count)} {unit}{'' if count == 1 else 's'}"


def share(part: int, total: int) -> str:
    """Format part of total as a percentage; 0% and 100% only where exact."""
    if total == 0:
        return NOTHING
    if part in (0, total):
        return "0%" if part == 0 else "100%"
    percent = 100 * part / total
    if percent < 0.1:
        return "<0.1%"
    return ">99.9%" if percent > 99.9 else f"{percent:.1f}%"


def number(value: float | int, digits: int = 3) -> str:
    """Format a number to ``digits`` significant digits, with a power of ten below 1e-3 and from 1e5."""
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else "\N{MINUS SIGN}∞"
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{decimals}f}"
        return (text.rstrip("0").rstrip(".") if decimals else text).replace("-", "\N{MINUS SIGN}")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = str(int(exponent)).translate(str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"))
    return f"{mantissa} \N{MULTIPLICATION SIGN} 10{power}".replace("-", "\N{MINUS SIGN}")


def percentage(value: float | int) -> str:
    """Format a ratio as a percentage of three significant digits, or more where it would round to 100%."""
    if not math.isfinite(value):
        return number(value)
    if 0.9995 <= value < 1:
        decimals = math.ceil(-math.log10(1 - value)) - 2
        return f"{100 * value:.{decimals}f}%"
    return number(100 * value) + "%"


def short_percentage(value: float) -> str:
    """Format a ratio as a percentage of two digits, for narrow columns."""
    return ">99.9%" if 0.999 < value < 1 else f"{number(100 * value, 2)}%" if math.isfinite(value) else number(value)


def degrees(radians: float) -> str:
    return number(math.degrees(radians)) + "°" if math.isfinite(radians) else NOTHING


def seconds(value: float | int) -> str:
    """Format a duration [s] in s, ms, µs or ns."""
    for unit, size in (("s", 1), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{number(value / size)} {unit}"
    return f"{number(value / 1e-9)} ns" if value > 0 else NOTHING


def swatch(colour: str) -> str:
    """Return an HTML square of a colour, which ties text to a figure."""
    return f'<span class="swatch" style="background:{colour}"></span>'


def table(head: list[str], rows: list[list[str]], css_class: str = "") -> str:
    """Return an HTML table from cells that are HTML already: escape text from outside before."""
    top = "".join(f"<th>{cell}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    content = f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="{css_class}">{content}</table></div>'


def text(value: object) -> str:
    """Escape text from outside for use inside HTML and attributes."""
    return escape(str(value), quote=True)


DPI = 130


def check_matplotlib(subject: str = "the figure needs") -> None:
    """Raise ImportError with the pip command where matplotlib is not installed."""
    optional_library("matplotlib.figure", missing=f"{subject} matplotlib: pip install 'jaxgrasp[report]'")


def write_png(path: Path, figure: "Figure") -> None:
    """Write a figure."""
    replace_file(path, partial(figure.savefig, format="png", dpi=DPI))
