"""``jaxgrasp experiment export``: tidy tables of trials, thresholds and persons, and what their columns mean."""

import csv
import io
from functools import partial
from typing import IO

from jaxgrasp.cli.experiment_analyse import analysed
from jaxgrasp.cli.experiment_arguments import Export
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import check_writable, replace_file
from jaxgrasp.psychophysics.analysis.tidy import Row, tidy_tables


def export_command(arguments: Export) -> int:
    """Read, analyse, write."""
    out = arguments.folder / "export" if arguments.out is None else arguments.out
    check_writable(out)
    tables = tidy_tables(*analysed(arguments))
    out.mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        replace_file(out / name, partial(_write, rows))
        show(f"written: {out / name}, {len(rows) - 1} rows")
    return 0


def _write(rows: list[Row], stream: IO[bytes]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    stream.write(text.getvalue().encode())
