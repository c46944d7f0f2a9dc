"""The page of the psychophysics in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import NOTHING, table

LARGER = 100
"""Answers a level from which coverage is judged: ten times one person's at the paper's design."""
COVERAGE_BOUNDS = (0.93, 0.97)
NUMBERS = (("bias", "+"), ("spread", ""), ("coverage", ""))
"""Of a row, with the sign that is shown."""


def page(report: dict) -> str:
    facts, effort = report["machine"], report["effort"]
    parts = [
        "# Psychophysics: what the analysis finds of what is there",
        f"Made by `python -m benchmarks.psychophysics`. {facts['processor']}, {facts['system']}, Python "
        f"{facts['python']}. Simulated experiments, {effort['experiments']:,} of each, at the paper's design: "
        "differences of 5, 10, 20 and 30 %; 10 answers a level of one person, 50 of five; and ten times as many.",
    ]
    sections = {
        "recovery": _recovery,
        "misfit": _misfit,
        "procedures": _procedures,
        "lapses": _lapses,
        "power": _power,
        "device": _device,
    }
    parts += [write(report[name]) for name, write in sections.items() if name in report]
    return "\n\n".join(parts) + "\n"


def _recovery(rows: list[dict]) -> str:
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((row["shape"], row["free"], row["method"], row["answers"]), []).append(row)
    lines = [
        [
            shape,
            "0 to 0.05" if free else "none",
            method,
            answers,
            f"{_percent(min(r['bias'] for r in group))} to {_percent(max(r['bias'] for r in group))}",
            f"{100 * max(r['spread'] for r in group if r['spread'] is not None):.0f}%"
            if any(r["spread"] is not None for r in group)
            else NOTHING,
            f"{100 * min(r['coverage'] for r in group):.1f} to {100 * max(r['coverage'] for r in group):.1f}%",
        ]
        for (shape, free, method, answers), group in groups.items()
    ]
    checked = [row for row in rows if row["answers"] >= LARGER and row["method"] == "likelihood" and not row["free"]]
    inside = sum(COVERAGE_BOUNDS[0] <= row["coverage"] <= COVERAGE_BOUNDS[1] for row in checked)
    text = (
        "## Recovery\n\nEach function fitted to answers drawn from itself, with thresholds as the paper prints them at "
        "1, 2 and 3 N; over these three, the range of the bias (median less truth, by the truth) and of the coverage "
        "of 95 % intervals, and the largest spread (half the distance of the quantiles at one standard deviation). "
        "Lapses: known to be none, or free up to 0.05 where they are 0.025.\n\n"
        f"Profile intervals of likelihood without lapses, at {LARGER} answers a level and more: {inside} of "
        f"{len(checked)} cover {100 * COVERAGE_BOUNDS[0]:.0f} to {100 * COVERAGE_BOUNDS[1]:.0f} %.\n\n"
    )
    head = ["function", "lapses", "method", "answers a level", "bias", "spread", "coverage"]
    return text + table(head, lines)


def _misfit(rows: list[dict]) -> str:
    lines = [
        [
            row["method"],
            row["answers"],
            _percent(row["bias"]),
            _percent(row["spread"], ""),
            _percent(row["coverage"], ""),
        ]
        for row in sorted(rows, key=lambda row: row["method"])
    ]
    text = (
        "## Which method for whom\n\nAnswers of an observer who compares two noisy sensations (the function "
        "`difference`), Weber fraction 0.163 at 2 N: what each method makes of them, lapses free up to 0.05; lines "
        "with bootstrap intervals. A method whose function is not the observer's keeps its bias however many answers "
        "there are, and its intervals miss the truth the more surely.\n\n"
    )
    return text + table(["method", "answers a level", "bias", "spread", "coverage of 95 %"], lines)


def _procedures(rows: list[dict]) -> str:
    lines = [
        [row["procedure"], row["trials"], *(_percent(row[name], sign) for name, sign in (*NUMBERS, ("none", "")))]
        for row in rows
    ]
    text = (
        "## What a procedure is worth\n\nThe threshold of one person from as many trials, all fitted alike (function "
        "`difference`, lapses free up to 0.05; there are none), with profile intervals of 95 %; the last column is how "
        "often answers settle no threshold.\n\n"
    )
    return text + table(["procedure", "trials", "bias", "spread", "coverage", "none"], lines)


def _lapses(rows: list[dict]) -> str:
    lines = [
        [row["procedure"], f"{100 * row['lapse']:g} %", row["trials"], f"up to {row['most']:g}"]
        + [_percent(row[name], sign) for name, sign in (*NUMBERS, ("none", ""))]
        for row in rows
    ]
    text = (
        "## Lapses, and beliefs of another shape\n\nThe same observer at 2 N, who errs in some share of all trials for "
        "want of attention; the truth is where the hit ratio is 0.75, lapses included. All are fitted by the function "
        "`difference`, lapses free up to what the table says; `jaxgrasp experiment analyse` takes 0.1 where levels "
        "follow the answers. An adaptive procedure that believes in another function than the fit "
        "asks where that one tells most.\n\n"
    )
    return text + table(["procedure", "lapses", "trials", "fitted", "bias", "spread", "coverage", "none"], lines)


def _power(rows: list[dict]) -> str:
    lines = [
        [
            f"{row['wanted']:g}",
            row["trials"],
            row["subjects"],
            f"{row['total']:,}",
            f"{row['within']:.3f}",
            _percent(row["outside"], ""),
        ]
        for row in rows
    ]
    text = (
        "## How many trials and persons\n\nFor a standard error of the mean Weber fraction at 2 N, persons differing "
        "by 0.035 as the paper's; the paper had 10 trials a level and 5 persons. Designs in which more than a tenth of "
        "the persons would have no threshold are left out.\n\n"
    )
    head = ["standard error", "trials a level", "persons", "trials in all", "one person's deviation", "no threshold"]
    return text + table(head, lines)


def _device(rows: list[dict]) -> str:
    lines = [
        [
            f"{row['sliding']:g}",
            f"{row['pretension']:g}",
            *(NOTHING if fraction is None else f"{100 * fraction:.1f}%" for fraction in row["fractions"]),
        ]
        for row in rows
    ]
    text = (
        "## What the device explains\n\nWeber fractions of weights that one should expect through the paper's glove of "
        "someone who tells real ones apart at 10 %: cables around guides of 180 degrees with a coefficient of friction "
        "in motion, and a pretension that keeps them taut; seven motions count, each with a direction at random. The "
        "paper found 24.4, 16.3 and 13.5 % at 1, 2 and 3 N. Friction, wrap and pretension of its glove are not "
        f"printed: these are assumptions. The glove's limit of 0.12 N m is {rows[0]['limit']:.2f} N on two fingers; a "
        f"count of its torque is {1e3 * rows[0]['quantum']:.2f} mN, which nobody feels.\n\n"
    )
    return text + table(["friction", "pretension [N]", "at 1 N", "at 1.5 N", "at 2 N"], lines)


def _percent(value: float | None, sign: str = "+") -> str:
    return NOTHING if value is None else f"{100 * value:{sign}.1f}%"
