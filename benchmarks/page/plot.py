"""Time against error of every method, alone and in batches."""

from pathlib import Path

COLOURS = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#e377c2", "#17becf", "#7f7f7f")
MARKS = "osD^v<>P"
FLOOR = 1e-17
"""Where an error of zero is drawn."""


def draw(rows: list[dict], path: Path) -> None:
    """Draw single problems with an active cone, and batches: one mark a method, five contacts if any."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    sizes = {row["n"] for row in rows}
    n = 5 if 5 in sizes else min(sizes)
    cells = list(dict.fromkeys(row["cell"] for row in rows))
    figure = Figure(figsize=(5.2 * len(cells) + 3.6, 5.2), layout="constrained")
    panels = figure.subplots(1, len(cells), sharey=True, squeeze=False)[0]
    marks = _marks([row for row in rows if row["n"] == n])
    for panel, cell in zip(panels, cells, strict=True):
        for row in rows:
            if row["n"] == n and row["cell"] == cell and row.get("which") != "closed form optimal":
                _mark(panel, row, marks[row["method"]])
        n_checked = max(row["judged"] for row in rows if row["n"] == n and row["cell"] == cell)
        panel.set(xscale="log", yscale="log", xlabel="microseconds a problem", title=_title(cell, n, n_checked))
        # Labels between the powers of ten run into each other.
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("largest force error, relative to the largest force")
    shown = {
        label: handle for panel in panels for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    figure.legend(shown.values(), shown.keys(), loc="outside right upper", fontsize=8)
    figure.savefig(path, dpi=110)


def _title(cell: str, n: int, n_checked: int) -> str:
    subject = "one call, cones active" if cell == "single" else f"batch of {int(cell.split()[1]):,}, or what 5 s allow"
    return f"ordinary, n = {n}: {subject}\n(errors: worst of {n_checked:,} problems)"


def _marks(rows: list[dict]) -> dict[str, tuple[str, str]]:
    """Assign a colour to each package and a mark to each of its methods."""
    packages = list(dict.fromkeys(row["package"] for row in rows))
    marks = {}
    for package in packages:
        methods = dict.fromkeys(row["method"] for row in rows if row["package"] == package)
        for i, method in enumerate(methods):
            marks[method] = (COLOURS[packages.index(package) % len(COLOURS)], MARKS[i % len(MARKS)])
    return marks


def _mark(panel, row: dict, mark: tuple[str, str]) -> None:
    if row["max_force_error"] is None:
        return
    colour, shape = mark
    hollow = row["dtype"] == "float32"
    panel.plot(
        row["microseconds"],
        max(row["max_force_error"], FLOOR),
        shape,
        color=colour,
        markerfacecolor="none" if hollow else colour,
        markersize=8,
        linestyle="none",
        label=row["method"],
    )
