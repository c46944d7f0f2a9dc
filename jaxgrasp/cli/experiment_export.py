"""``jaxgrasp experiment export``: tidy tables of trials, thresholds and persons, and what their columns mean."""

from jaxgrasp.cli.experiment_analyse import analysed
from jaxgrasp.cli.experiment_arguments import Export
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.csv_rows import write_rows
from jaxgrasp.files.replace import check_writable
from jaxgrasp.psychophysics.analysis.tidy import tidy_tables


def export_command(arguments: Export) -> int:
    """Read, analyse, write."""
    out = arguments.folder / "export" if arguments.out is None else arguments.out
    check_writable(out)
    tables = tidy_tables(*analysed(arguments))
    out.mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        write_rows(out / name, rows)
        show(f"written: {out / name}, {len(rows) - 1} rows")
    return 0
