"""``jaxgrasp experiment paper``: the paper's numbers, recomputed."""

from collections import Counter

from jaxgrasp.cli.experiment_arguments import Paper
from jaxgrasp.cli.terminal import show
from jaxgrasp.psychophysics.recomputed import recomputed


def paper_command(command: Paper) -> int:
    """Print the table of printed and recomputed numbers, notes on its rows, and a count of the outcomes."""
    rows = recomputed()
    widths = [max(len(getattr(row, name)) for row in rows) for name in ("quantity", "printed", "recomputed")]
    head = ("quantity", "printed", "recomputed (range by rounding)")
    show("  ".join(f"{text:{width}}" for text, width in zip(head, widths, strict=True)) + "  outcome")
    for row in rows:
        cells = (row.quantity, row.printed, row.recomputed)
        show("  ".join(f"{text:{width}}" for text, width in zip(cells, widths, strict=True)) + f"  {row.outcome}")
        if row.note:
            show(f"    {row.note}")
    counts = Counter(row.outcome for row in rows)
    show("; ".join(f"{counts[outcome]} {outcome}" for outcome in dict.fromkeys(row.outcome for row in rows)))
    return 0
