"""Tables of a few rows as CSV files."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from jaxgrasp.files.replace import replace_file


def write_rows(path: Path, rows: Iterable[Sequence]) -> None:
    """Write rows, of which the first names the columns, whole or not at all."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    replace_file(path, lambda stream: stream.write(text.getvalue().encode()))
