"""``jaxgrasp experiment paper``: the paper's numbers, recomputed."""

from collections import Counter

from jaxgrasp.cli.experiment_arguments import Paper
from jaxgrasp.psychophysics.recomputed import recomputed


def paper_command(command: Paper) -> int:
    """A table, and what is to be known of its rows."""
    rows = recomputed()
    widths = [max(len(getattr(row, name)) for row in rows) for name in ("quantity", "printed", "recomputed")]
    head = ("quantity", "printed", "recomputed (range by rounding)")
    print("  ".join(f"{text:{width}}" for text, width in zip(head, widths, strict=True)) + "  outcome")
    for row in rows:
        cells = (row.quantity, row.printed, row.recomputed)
        print("  ".join(f"{text:{width}}" for text, width in zip(cells, widths, strict=True)) + f"  {row.outcome}")
        if row.note:
            print(f"    {row.note}")
    counts = Counter(row.outcome for row in rows)
    print("; ".join(f"{counts[outcome]} {outcome}" for outcome in dict.fromkeys(row.outcome for row in rows)))
    return 0
