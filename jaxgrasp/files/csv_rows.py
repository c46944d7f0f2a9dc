"""Tables of a few rows as CSV files."""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from jaxgrasp.files.printable import printable
from jaxgrasp.files.replace import replace_file

_FORMULA = re.compile(r"'*[=+\-@]")
"""The start of a cell that a spreadsheet takes for a formula, and of a formula that an apostrophe marks as text."""


def safe_cell(value: Any) -> Any:
    """Return the value for a cell, with text of unknown origin made safe: no formula and no control characters.

    Control characters are escaped as Python writes them, formulas as `formula_as_text` does.
    """
    return formula_as_text(printable(value)) if isinstance(value, str) else value


def formula_as_text(text: str) -> str:
    """Return text with an apostrophe in front where a spreadsheet would compute it; numbers stay.

    A spreadsheet takes the apostrophe for "this is text". `text_of_formula` gives the text back, whatever it is.
    Source: OWASP, "CSV Injection".
    """
    return f"'{text}" if _FORMULA.match(text) and not _is_number(text) else text


def text_of_formula(cell: str) -> str:
    """Return the text that `formula_as_text` made this cell of."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_rows(path: Path, rows: Iterable[Sequence]) -> None:
    """Write rows, of which the first names the columns, whole or not at all."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([safe_cell(value) for value in row] for row in rows)
    replace_file(path, lambda stream: stream.write(text.getvalue().encode()))
