"""The page of the measures of quality in Markdown, from the report that the JSON holds too."""

from itertools import groupby

from benchmarks.page.tables import by_size, made_by, table


def page(report: dict) -> str:
    parts = ["# Measures of quality: cost, bounds, pyramids", _preface(report)]
    if "batches" in report:
        parts += [
            "## Many grasps in one call",
            f"Milliseconds of CPU for a grasp of {report['plan']['many']:,}, for balls of {report['plan']['batch']}, "
            "whose contacts lie anywhere on a ball, closed or not, after compiling; balls to the relative distance of "
            "their bounds that stands there. Beside them Qhull (scipy), one hull after the other: the median.",
            by_size(report["batches"], "measure", lambda row: _ms(row["seconds"])),
        ]
    if "times" in report:
        parts += [
            "## Time for one grasp",
            "Milliseconds of CPU a call after compiling: the median, and the largest in brackets. Balls to a relative "
            "distance of their bounds of 1e-3, largest wrenches 1e-6.",
            by_size(report["times"], "measure", lambda row: f"{_ms(row['median'])} ({_ms(row['largest'])})"),
        ]
    if "gaps" in report:
        parts += [
            "## Distance of the bounds by points",
            "Relative to the upper bound: the median, and the largest in brackets; then milliseconds of CPU a grasp. "
            "The search ends before at 1e-4.",
            table(["bound", "n", "points", "distance", "ms"], [_gap(row) for row in report["gaps"]]),
        ]
    if "pyramids" in report:
        parts += [
            "## What pyramids miss",
            "By how much their ball is smaller than the cones', relative to it: the median, and the largest in "
            "brackets; 100 % where no pyramid's forces close the grasp, though the cones' do.",
            table(["bound", "n", *_sides(report)], _short_rows(report["pyramids"])),
        ]
    if "decisions" in report:
        parts += [
            "## Force closure decided",
            "Closed / open / undecided.",
            by_size(report["decisions"], "kind", lambda row: f"{row['closed']} / {row['open']} / {row['undecided']}"),
        ]
    return "\n\n".join(parts) + "\n"


def _preface(report: dict) -> str:
    facts = report["machine"]
    return (
        f"{made_by('quality', facts, ('jax', 'scipy'))}.\n\n"
        f"{report['plan']['grasps']} ordinary grasps of each size that are closed (`jaxgrasp/testing/problems.py`)."
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def _gap(row: dict) -> list[str]:
    distance = f"{row['median']:.0e} ({row['largest']:.0e})"
    return [row["bound"], str(row["n"]), str(row["points"]), distance, _ms(row["seconds"])]


def _sides(report: dict) -> list[str]:
    return [f"{sides} sides" for sides in sorted({row["sides"] for row in report["pyramids"]})]


def _short_rows(rows: list[dict]) -> list[list[str]]:
    shown = []
    for (bound, n), group in groupby(rows, key=lambda row: (row["bound"], row["n"])):
        cells = [f"{100 * row['median']:.2g} % ({100 * row['largest']:.2g} %)" for row in group]
        shown.append([bound, str(n), *cells])
    return shown
