"""The page of the suite in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import NOTHING, made_by, power, table

OUTCOMES = (
    *("right", "infeasible proven", "infeasible claimed", "said so"),
    *("wrong in silence", "infeasible called solved"),
)
WRONG = ("wrong in silence", "infeasible called solved")


def page(report: dict) -> str:
    """Return the page."""
    scores = report["scores"]
    versions = "".join(f", {name} {version}" for name, version in scores["packages"].items())
    missing = "".join(f"\n{line}\n" for line in scores["missing"])
    return (
        "\n\n".join(
            [
                "# The suite of hard problems, and every solver's score",
                made_by("suite", report["machine"], ("jaxgrasp", "jax")) + f"{versions}.\n{missing}",
                _explanation(scores),
                "## Scores",
                table(_HEAD, [_line(row) for row in scores["rows"]]),
                "## By kind",
                "Wrong in silence and infeasible called solved / said so, of the problems of a kind. Each solver has "
                "its settings with the most right answers and then the fewest wrong ones. A dash stands for neither.",
                _by_kind(scores),
            ]
        )
        + "\n"
    )


_HEAD = (
    *("solver", "settings", "tolerance", "data", *OUTCOMES, "of the wrong, nearby"),
    *("worst objective of the right", "µs a problem"),
)


def _explanation(scores: dict) -> str:
    return (
        f"Version {scores['version']} of [the suite](../../docs/suite.md): {scores['problems']} problems, "
        f"{scores['infeasible']} of them infeasible, each with a reference in extended precision. A right answer errs "
        "by at most 100 of its solver's own tolerances (at least 1e-6) in balance, cones and objective. *Infeasible "
        "proven* needs a twist that proves a total force of a million loads. Of the wrong ones, *nearby* counts forces "
        "that balance and obey the cones within that tolerance, but whose cost is not the optimum's, or for which no "
        "exact solution exists: the answer to a problem nearby. *Said so* counts failures that a solver reports, "
        "almost solved ones included. Scaled problems are centred, of loads and lengths of order one; raw ones are "
        "in newtons and metres in the user's frame. Times are medians: of one call for each problem, set-up included, "
        "and for jaxgrasp of one call for all problems, padded to 5 or 15 contacts, over their number. In float32 the "
        "data are rounded first, which makes other problems of many; the references stay those of the data in float64."
    )


def _name(row: dict) -> str:
    name = row["solver"].removeprefix("jaxgrasp").replace("-", " ").strip()
    return f"**jaxgrasp{' ' + name if name else ''}**" if row["solver"].startswith("jaxgrasp") else row["solver"]


def _data(row: dict) -> str:
    return "raw" if row["scaled"] in (None, False) else "scaled"


def _line(row: dict) -> list[object]:
    counts = row["counts"]
    nearby = counts["wrong, nearby"] + counts["infeasible solved, nearby"]
    return [
        *(_name(row), row["settings"], power(row["tolerance"]), _data(row)),
        *(f"{counts[outcome]:,}" for outcome in OUTCOMES),
        *(nearby, power(row["worst_objective"]), f"{row['microseconds']:,.0f}"),
    ]


def best_rows(scores: dict) -> dict[str, dict]:
    """Return the row of each solver with the most right answers, and among these the fewest wrong ones."""
    best: dict[str, dict] = {}
    for row in scores["rows"]:
        old = best.get(row["solver"])
        if old is None or rank(row) < rank(old):
            best[row["solver"]] = row
    return best


def wrong(counts: dict) -> int:
    """Return the number of silently wrong answers."""
    return sum(counts[outcome] for outcome in WRONG)


def right(counts: dict) -> int:
    """Return the number of right answers, claims of infeasibility included."""
    return counts["right"] + counts["infeasible proven"] + counts["infeasible claimed"]


def rank(row: dict) -> tuple[int, int]:
    """Return what rows are compared by: the less the better."""
    return -right(row["counts"]), wrong(row["counts"])


def _by_kind(scores: dict) -> str:
    best = best_rows(scores)
    lines = []
    for kind, facts in scores["kinds"].items():
        if not facts["problems"]:
            continue
        cells = []
        for row in best.values():
            counts = row["kinds"][kind]
            failed = counts["said so"]
            cells.append(f"{wrong(counts)} / {failed}" if wrong(counts) or failed else NOTHING)
        lines.append([kind, facts["problems"], facts["infeasible"], *cells])
    heads = [
        _name(row) + ("" if row["scaled"] is None else f", {row['settings']}, {_data(row)}") for row in best.values()
    ]
    return table(["kind", "problems", "infeasible", *heads], lines)


def line(report: dict) -> str:
    """Return README's sentence."""
    scores = report["scores"]
    ours = best_rows(scores)["jaxgrasp"]["counts"]
    return (
        f"On [{scores['problems']} hard problems](docs/suite.md) {right(ours)} answers are right, {ours['said so']} "
        f"report their failure and {wrong(ours)} are wrong ([scores](benchmarks/results/suite.md))."
    )
