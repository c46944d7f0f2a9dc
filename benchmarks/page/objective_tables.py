"""The page of forces by other objectives in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import by_size, made_by, table

VERDICT_COLUMNS = [
    "kind",
    "objective",
    "optimal",
    "not converged",
    "infeasible",
    "gap to the bound, median",
    "worst",
    "compared with Clarabel",
    "most above it",
    "most below it",
]


def page(report: dict) -> str:
    parts = ["# Forces by other objectives", _preface(report)]
    if "times" in report:
        parts += ["## What they cost", _about_times(report), by_size(_named(report["times"]), "objective", _cell, "")]
    if "right" in report:
        parts += [
            "## How good they are",
            _about_right(report),
            table(VERDICT_COLUMNS, map(_verdict_row, report["right"])),
        ]
    return "\n\n".join(parts) + "\n"


def _preface(report: dict) -> str:
    facts = report["machine"]
    return (
        f"{made_by('objectives', facts, ('jax',))}; float64. Soft fingers among hard ones, bounded "
        f"normal forces and {report['plan']['joints']} limited joints, drawn about the forces behind each wrench."
    )


def _about_times(report: dict) -> str:
    return (
        f"Microseconds a problem in a batch of {report['plan']['batch']} ordinary ones, after compiling; in brackets "
        "Clarabel's for one of them after the other, each set up by NumPy, in turns. The margin is a root, and each "
        "look at it a cone program."
    )


def _about_right(report: dict) -> str:
    return (
        f"{report['plan']['judged']} problems of four contacts of each kind. Gaps and distances are relative to the "
        "value; distances are from Clarabel's value wherever it calls its problem solved."
    )


def _named(rows: list[dict]) -> list[dict]:
    return [row | {"objective": f"`{row['objective']}`"} for row in rows]


def _cell(row: dict) -> str:
    seconds = row["seconds"]
    theirs = f" ({1e6 * seconds['clarabel']:,.0f})" if "clarabel" in seconds else ""
    return f"{1e6 * seconds['ours']:,.0f}{theirs}"


def _verdict_row(row: dict) -> list[str]:
    counts = [str(row[name]) for name in ("optimal", "not converged", "infeasible")]
    gaps = [f"{row[name]:.0e}" for name in ("median_gap", "worst_gap")]
    theirs = [str(row["compared"]), f"{row['above']:.0e}", f"{row['below']:.0e}"] if "compared" in row else ["-"] * 3
    return [row["kind"], f"`{row['objective']}`", *counts, *gaps, *theirs]
