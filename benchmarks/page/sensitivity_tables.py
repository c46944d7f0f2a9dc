"""The sensitivity page in Markdown, from the report that the JSON holds too."""

import math

from benchmarks.page.tables import table

COMPARED = {
    "worst_of_the_index": "index, worst of the cycle",
    "worst_of_all": "any finger, worst of the cycle",
    "index_at_an_instant": "index, instant by instant",
    "largest_at_an_instant": "any finger, instant by instant",
}


def page(report: dict) -> str:
    sweep, facts = report["sweep"], report["machine"]
    times = report["derivatives"][0]
    return (
        "\n\n".join(
            [
                "# Sensitivity along the paper's task",
                f"Made by `python -m benchmarks.sensitivity`. {facts['processor']}, {facts['system']}, Python "
                f"{facts['python']}, jax {facts['versions']['jax']}.",
                "## Derivatives of the slip angles",
                f"Five fingers at {times['times']:,} times by {times['parameters']} parameters, one thread, float64, "
                "milliseconds. Central differences are batched into one compiled call. Errors are relative to 1 rad or "
                "the derivative, judged by differences of sixth order; all but a thousandth, and the largest: where "
                "a finger comes to its cone within a step, no difference is right.",
                table(
                    ["method", "curves alone", "with derivatives", "central differences", "ratio", "error", "theirs"],
                    map(_derivatives, report["derivatives"]),
                ),
                "## Optima one after the other",
                "The same task, one optimum at a time in a compiled loop; a cone is active at "
                f"{100 * report['consecutive'][0]['active']:.0f} % of the instants. Microseconds an optimum, and "
                "Newton steps where a cone is active, from the closed form and from the last instant's multiplier "
                "(`constrained_optimum(..., start=)`); beside them all instants as one batch. Apart: the largest "
                "difference of forces between the last two, relative to the largest force.",
                table(
                    ["step", "from the closed form", "from the last", "ratio", "Newton steps", "one batch", "apart"],
                    map(_consecutive, report["consecutive"]),
                ),
                "## Designs",
                "The task's worst margin, before and after `raise_worst` moved what stands beside it: places by 0.6 "
                "rad and 8 mm at most, contributions between 0.05 and 4 without a change of their sum. Judged at ten "
                "times as many instants as the design looked at. A reserve below 1 lets the object slip whatever the "
                "hand does with the normal forces that it means to exert. Seconds are those of a first call, mostly "
                "compiling.",
                table(["worst", "moved", "before", "after", "seconds"], map(_design, report["designs"])),
                f"## {sweep['settings']:,} tasks drawn about the paper's",
                "Places, friction and contributions vary. How often the slip angle by method B is the larger, and by "
                "how many degrees then: median, and largest.",
                table(["slip angle", "B worse than A", "median", "largest"], map(_compared(sweep), COMPARED)),
                _closing_text(sweep),
            ]
        )
        + "\n"
    )


def _derivatives(row: dict) -> list[str]:
    spent = row["milliseconds"]
    errors = [f"{e['of_all_but_a_thousandth']:.0e}, {e['largest']:.0e}" for e in (row["error"], row["central_error"])]
    times = [f"{spent[name]:.1f}" for name in ("curves", "ours", "central")]
    return [row["method"], *times, f"{spent['central'] / spent['ours']:.1f}", *errors]


def _consecutive(row: dict) -> list[str]:
    spent, steps = row["microseconds"], row["newton_steps"]
    cold, warm = spent["from_the_closed_form"], spent["from_the_last"]
    taken = f"{steps['from_the_closed_form']:.1f}, {steps['from_the_last']:.1f}"
    return [
        f"{1e3 * row['step']:g} ms",
        f"{cold:.1f}",
        f"{warm:.1f}",
        f"{cold / warm:.2f}",
        taken,
        f"{spent['in_one_batch']:.1f}",
        f"{row['apart']:.0e}",
    ]


def _design(row: dict) -> list[str]:
    is_angle = row["margin"].startswith("friction margin")
    before, after = (f"{math.degrees(x):.1f}°" if is_angle else f"{x:.2f}" for x in (row["before"], row["after"]))
    return [row["margin"], ", ".join(row["moved"]), before, after, f"{row['seconds']:.0f}"]


def _compared(sweep: dict):
    def row(name: str) -> list[str]:
        comparison = sweep[name]
        return [
            COMPARED[name],
            f"{100 * comparison['share']:.1f} %",
            f"{comparison['median']:.1f}",
            f"{comparison['largest']:.1f}",
        ]

    return row


def _closing_text(sweep: dict) -> str:
    pulls, outside = sweep["settings_in_which_it_pulls"], sweep["instants_outside_the_cones"]
    distance, price = sweep["distance_where_active"], sweep["price_where_active"]
    exist = sweep["instants_that_forces_exist_for"]
    return (
        f"A pulls at a finger in {100 * pulls['A']:.0f} % of the tasks, B in {100 * pulls['B']:.0f} %. "
        f"A's forces lie outside the friction cones at {100 * outside['A']:.0f} % of the instants, B's at "
        f"{100 * outside['B']:.0f} %; forces inside them exist at {100 * exist:.1f} %. "
        f"Where a cone is active, B's optimum lies {distance['0.5']:.2f} of the largest force away in the median "
        f"({distance['0.9']:.2f} at the ninth decile, {distance['1.0']:.2f} at most), and "
        f"{100 * price['0.5']:.0f} % of its objective is the price of friction ({100 * price['0.9']:.0f} % at the "
        f"ninth decile)."
    )
