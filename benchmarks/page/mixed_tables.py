"""The page of mixed batches in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import by_size, made_by, table

HEAD = [
    "n",
    "batch",
    "load",
    "infeasible",
    "undecided",
    "verdicts differ",
    "µs",
    "beside ordinary",
    "Clarabel anew",
    "updated",
]
LOADS = {
    "any": "contacts at random on a unit sphere, any wrench of about 1 N and 0.3 N m;",
    "lift": "the same, a lift of 3 N by contacts on the upper half alone;",
    "carton": "contacts anywhere on the six faces of a box of 6 by 8 by 20 cm, whose weight of 3 N points anywhere;",
    "bottle": "a thumb opposite to fingers on a cylinder, lifted and tipped while its content runs to the neck;",
    "limit": "half one per cent inside and half one per cent beyond the largest load that the grasp can bear;",
    "shipped": "the simulated grips that come with the package, all of n contacts.",
}
"""What each family is of."""
ABOUT = (
    "Families of grasps and loads. Of the first four, contacts press inward, with a friction of 0.2 to 0.6 and a "
    "squeeze of 0.5 to 5 N; the last two are of few problems, repeated. Microseconds a problem, jitted, medians in "
    "turns; then how many times the cost of an ordinary batch, all of which can be solved, and how many times longer "
    "Clarabel takes for the same problems, its loop in Python included: set up anew, and updated in place. Verdicts "
    "differ where Clarabel solves what we call infeasible, or the other way round."
)


def page(report: dict) -> str:
    plan = report["plan"]
    parts = [
        "# Mixed batches",
        f"{made_by('mixed', report['machine'], ('jax', 'clarabel'))}; float64.",
    ]
    if "families" in report:
        parts += ["## Families", ABOUT, _loads(), table(HEAD, map(_family, report["families"]))]
    if "sweep" in report:
        parts += [
            "## By the share that is infeasible",
            f"Lifts, batches of {plan['batch']:,}. Microseconds a problem, and in brackets how many times the cost of "
            "an ordinary batch.",
            by_size([row | {"infeasible": f"{row['share']:.0%}"} for row in report["sweep"]], "infeasible", _share),
        ]
    return "\n\n".join(parts) + "\n"


def _loads() -> str:
    return "\n".join(f"- {name}: {about}" for name, about in LOADS.items())


def _family(row: dict) -> list[str]:
    microseconds = row["microseconds"]
    return [
        str(row["n"]),
        f"{row['batch']:,}",
        row["load"],
        f"{row['infeasible']:.1%}",
        *(str(row[name]) for name in ("undecided", "differ")),
        f"{microseconds['ours']:.1f}",
        *(
            f"{ratio:.1f}"
            for ratio in (microseconds["ours"] / microseconds["ordinary"], microseconds["anew"] / microseconds["ours"])
        ),
        f"{microseconds['updated'] / microseconds['ours']:.1f}",
    ]


def _share(row: dict) -> str:
    return f"{row['microseconds']:.1f} ({row['ratio']:.1f})"
