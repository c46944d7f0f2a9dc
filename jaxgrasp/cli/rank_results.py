"""``jaxgrasp rank``: the grasps of an evaluation in the order of any column of its table."""

from jaxgrasp.batch.ranked_rows import ranked_rows
from jaxgrasp.cli.rank_arguments import Rank
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.printable import printable


def rank_command(arguments: Rank) -> int:
    """Show the first grasps as a table."""
    rows = ranked_rows(arguments.results, arguments.by, arguments.top, arguments.smallest)
    cells = [[name, *map(_cell, values.tolist())] for name, values in rows.items()]
    widths = [max(map(len, column)) for column in cells]
    for line in zip(*cells, strict=True):
        show("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip())
    return 0


def _cell(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))
