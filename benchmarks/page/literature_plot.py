"""Time against the worst friction margin of the literature's methods, one panel a case."""

from pathlib import Path

from benchmarks.page.plot import COLOURS, MARKS


def draw(rows: list[dict], path: Path) -> None:
    """Draw one mark a method: hollow where some of its answers leave the cones or are missing."""
    from matplotlib.figure import Figure

    cases = list(dict.fromkeys(row["case"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(4.2 * len(cases) + 2.4, 4.6), layout="constrained")
    panels = figure.subplots(1, len(cases), sharey=True, squeeze=False)[0]
    for panel, case in zip(panels, cases, strict=True):
        for row in rows:
            if row["case"] == case and row["margin_degrees_median"] is not None:
                _mark(panel, row, methods.index(row["method"]))
        panel.axhline(0, color="black", linewidth=0.8)
        panel.set(xscale="log", xlabel="microseconds a problem, in a batch", title=case)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("margin of the worst contact, median [degrees]")
    handles = {name: mark for panel in panels for mark, name in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside right upper", fontsize=8)
    figure.savefig(path, dpi=110)


def _mark(panel, row: dict, position: int) -> None:
    colour, shape = COLOURS[position % len(COLOURS)], MARKS[position % len(MARKS)]
    is_complete = row["outside_cones"] == 0 and row["given"] == sum(row["statuses"].values())
    panel.plot(
        row["microseconds"],
        row["margin_degrees_median"],
        shape,
        color=colour,
        markerfacecolor=colour if is_complete else "none",
        markersize=8,
        linestyle="none",
        label=row["method"],
    )
