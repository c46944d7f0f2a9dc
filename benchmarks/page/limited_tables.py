"""The page of soft fingers and limited hands in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import by_size, made_by, table

KINDS = [
    "kind",
    "limits",
    "sharing",
    "solved",
    "infeasible",
    "undecided",
    "verdicts differ",
    "worst gap",
    "least proof",
]


def page(report: dict) -> str:
    parts = ["# Soft fingers and limited hands", _preface(report)]
    if "times" in report:
        parts += ["## What they cost", _about_times(report), by_size(report["times"], "way", _cell, "")]
    if "right" in report:
        parts += ["## Right or wrong", ABOUT_RIGHT, table(KINDS, map(_kind, report["right"]))]
    return "\n\n".join(parts) + "\n"


def _preface(report: dict) -> str:
    facts = report["machine"]
    return f"{made_by('limited_hands', facts, ('jax',))}; float64."


def _about_times(report: dict) -> str:
    plan = report["plan"]
    return (
        f"Microseconds a problem in a batch of {plan['batch']:,} ordinary ones that have an answer, and how many times "
        f"the optimum of the same problems by hard fingers without limits, in turns. Hands of {plan['joints']} joints. "
        "The optimum without them breaks some limits by up to a tenth; in brackets how many bind in the mean, once "
        "they hold."
    )


ABOUT_RIGHT = (
    "Soft fingers among hard ones, bounded normal forces and six limited joints, four contacts. Limits are drawn about "
    "the forces behind each wrench, so that all but the infeasible kind can be solved, and are then multiplied by "
    "what the second column says. Verdicts against Clarabel's where it has one; the worst gap is ours above Clarabel's "
    "objective, relative; the least proof is the total force that a certificate proves to be needed, in loads."
)


def _cell(row: dict) -> str:
    binding = f" ({row['binding']:.1f})" if row["binding"] else ""
    return f"{row['microseconds']['this']:.1f}: {row['ratio']:.2f} times{binding}"


def _kind(row: dict) -> list[str]:
    return [
        row["kind"],
        f"x {row['tight']:g}",
        row["sharing"],
        *(str(row[name]) for name in ("solved", "infeasible", "undecided", "differ")),
        f"{row['gap']:.0e}",
        f"{row['least_proof']:.0e}",
    ]
