"""Tables of a few rows as CSV files."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from jaxgrasp.files.printable import printable
from jaxgrasp.files.replace import replace_file

FORMULA_STARTS = ("=", "+", "-", "@")
"""Characters with which a spreadsheet takes a cell for a formula."""


def safe_cell(value: Any) -> Any:
    """Return the value of a cell; text from anybody's file as neither a formula nor control characters.

    Control characters are escaped as Python writes them. Text that a spreadsheet would compute gets an apostrophe in
    front, which it takes for "this is text"; text that reads as a number stays.
    Source: OWASP, "CSV Injection".
    """
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if text.startswith(FORMULA_STARTS) and not _is_number(text) else text


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
