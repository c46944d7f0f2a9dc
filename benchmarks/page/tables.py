"""The page in Markdown, from the report that the JSON holds too."""

from collections.abc import Callable, Iterable
from itertools import groupby
from typing import Any

from benchmarks.laws import LAWS, Laws
from benchmarks.page.stress import UNBOUNDED

NOTHING = "-"
DECIDED = ("right", "wrong", "failed")


def page(report: dict) -> str:
    if timed := report.get("singles", []) + report.get("batches", []):
        report = report | {"times": sorted(timed, key=lambda row: row["n"])}
    parts = ["# The constrained optimum and its rivals", _preface(report)]
    sections: dict[str, Callable[[Any], str]] = {
        "times": _times,
        "extras": _extras,
        "stress": _stress,
        "decisions": _decisions,
        "gradients": _gradients,
    }
    parts += [write(report[name]) for name, write in sections.items() if name in report]
    return "\n\n".join(parts) + "\n"


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def made_by(name: str, facts: dict, packages: Iterable[str]) -> str:
    """Return the command that makes a page and the machine that made it, without a full stop."""
    versions = "".join(f", {package} {facts['versions'][package]}" for package in packages)
    return (
        f"Made by `python -m benchmarks.{name}`. {facts['processor']}, one thread, {facts['system']}, "
        f"Python {facts['python']}{versions}"
    )


def by_size(rows: Iterable[dict], name: str, show: Callable[[dict], str], head: str | None = None) -> str:
    """Tabulate ``show`` of each row: lines by the rows' ``name``, columns by their n."""
    cells = {(row[name], row["n"]): show(row) for row in rows}
    sizes = sorted({n for _, n in cells})
    body = [[label, *(cells.get((label, n), NOTHING) for n in sizes)] for label in dict.fromkeys(x for x, _ in cells)]
    return table([name if head is None else head, *(f"n = {n}" for n in sizes)], body)


def power(value: float | None) -> str:
    if value is None:
        return NOTHING
    return "unbounded" if value >= UNBOUNDED else f"{value:.0e}"


def _micro(row: dict | None, planned: int) -> str:
    if row is None:
        return NOTHING
    smaller = f" (batch of {row['batch']:,})" if row["batch"] != planned else ""
    return f"{row['microseconds']:,.3g} ({row['to_closed_form']:,.3g}x){smaller}"


def _preface(report: dict) -> str:
    machine = report["machine"]
    missing = "".join(f"\n{line}\n" for line in report["missing"])
    wide = "extended precision" if report["extended_precision"] else "double precision: this machine has no wider one"
    return (
        f"{made_by('constrained_optimum', machine, machine['versions'])}.\n{missing}\n"
        "Answers are judged by NumPy code that shares nothing with any solver, in "
        f"{wide}. The reference of a problem is the pair of forces and multiplier, of all methods in the run, whose "
        "duality gap, backward error and cone violation are the least; so an error below the square root of the "
        "reference's own gap says little. Solvers that are not called through jaxgrasp get data put in order (centred, "
        "load and lengths of order one), and neither that nor anything that can be kept between calls is timed. "
        "A rival counts as having solved what it reports as solved, not what it reports as almost solved."
    )


def _times(rows: list[dict]) -> str:
    text = [
        "## Time and error on ordinary problems",
        "Method B. Microseconds a problem, medians of interleaved turns, and in brackets the ratio to "
        "`jaxgrasp.closed_form` in float64 in the same column. *Single* is one call on one problem: one whose closed "
        "form is optimal, and one with an active cone; a turn there is as many calls as fit into 2 ms. Where a call "
        "would take more than five seconds, a smaller batch is measured, or none. Loops in Python cost the same in any "
        "batch. Errors are the worst over the problems that the method claims to have solved, in the smaller batch; "
        "for the closed form they are the price of ignoring friction.",
    ]
    for n, group in groupby(rows, key=lambda row: row["n"]):
        text += _times_of_size(n, list(group))
    return "\n\n".join(text)


def _times_of_size(n: int, rows: list[dict]) -> list[str]:
    cells = {(row["method"], row["cell"], row.get("which")): row for row in rows}
    batches = sorted({row["cell"] for row in rows if row["cell"] != "single"}, key=lambda name: int(name.split()[1]))
    sizes = {name: int(name.split()[1]) for name in batches}
    columns = ["method", "single, closed form optimal", "single, cones active"]
    columns += [*(f"batch of {size:,}" for size in sizes.values()), "solved", "force error, median", "worst"]
    columns += ["objective error", "own gap", "backward error", "cone violation"]
    lines = []
    for name in dict.fromkeys(row["method"] for row in rows):
        kinds = [cells.get((name, "single", kind)) for kind in ("closed form optimal", "cones active")]
        row = cells.get((name, batches[0], None)) if batches else None
        errors = ["median_force_error", "max_force_error", "max_excess", "max_gap", "max_backward_error"]
        shown = [NOTHING] * 7
        if row is not None:
            shown = [f"{row['solved']}/{row['judged']}", *(power(row[key]) for key in [*errors, "max_violation"])]
        times = [_micro(kind, 1) for kind in kinds]
        times += [_micro(cells.get((name, cell, None)), size) for cell, size in sizes.items()]
        lines.append([name, *times, *shown])
    batch_row = next((row for row in rows if row["cell"] != "single"), None)
    if batch_row is None:
        return [f"### {n} contacts", "Single problems alone: errors are those of batches.", table(columns, lines)]
    chosen = ", ".join(f"{name} {count}" for name, count in batch_row["references"].items())
    about = (
        f"Share with an active cone: {batch_row['active_share']:.2f}. References: {chosen}; the worst of them "
        f"proves itself to {power(batch_row['worst_reference'])}."
    )
    return [f"### {n} contacts", about, table(columns, lines)]


def _extras(extras: dict) -> str:
    optimal_rows = extras["closed_form_optimal"]
    free = table(
        ["n", "optimum µs", "closed form µs", "ratio", "all were closed-form optimal"],
        [
            [
                r["n"],
                f"{r['optimum_microseconds']:.3g}",
                f"{r['closed_form_microseconds']:.3g}",
                f"{r['ratio']:.2f}",
                r["all_closed_form_optimal"],
            ]
            for r in optimal_rows
        ],
    )
    keys = ["median_price", "median_force_distance", "max_force_distance", "median_violation"]
    price = table(
        ["n", "sharing", "active", "price", "force distance, median", "worst", "cone violation"],
        [
            [r["n"], r["sharing"], f"{r['active_share']:.2f}", *(f"{r[key]:.2g}" for key in keys)]
            for r in extras["price_of_friction"]
        ],
    )
    return "\n\n".join(
        [
            "## Our own routes",
            f"A batch of {optimal_rows[0]['batch']:,} whose closed forms are all optimal, "
            "against the closed form itself:",
            free,
            "Each closed form against its own optimum, where a cone is active: relative rise of the objective, "
            "distance of forces and distance from the cones relative to the largest force.",
            price,
            "Microseconds a problem, or a Jacobian, by route (n = 5):",
            table(["route", "µs"], [[name, f"{value:.3g}"] for name, value in extras["routes"].items()]),
            "Microseconds a problem by batch (n = 5):",
            table(["batch", "µs"], [[f"{int(size):,}", f"{value:.3g}"] for size, value in extras["batches"].items()]),
            "Seconds to trace and compile, for one shape, nothing cached:",
            table(
                ["n", "closed form", "optimum"],
                [[r["n"], f"{r['closed_form']:.1f}", f"{r['optimum']:.1f}"] for r in extras["compiling"]],
            ),
            _devices(extras["devices"]),
        ]
    )


def _devices(microseconds: dict) -> str:
    if len(microseconds) < 2:
        return "This machine has one core, so that devices could not be compared."
    one_device, two_devices = microseconds["1"], microseconds["2"]
    return (
        f"`jaxgrasp.evaluate` of method B's optimum on one device of one core, and on two of one core each: "
        f"{one_device:.3g} and {two_devices:.3g} µs a problem (n = 5), {one_device / two_devices:.2f} times as fast."
    )


def _stress(rows: list[dict]) -> str:
    text = ["## Our verdicts on every kind of problem"]
    for dtype, group in groupby(sorted(rows, key=lambda row: row["dtype"], reverse=True), key=lambda row: row["dtype"]):
        laws = LAWS[dtype]
        text.append(
            f"{dtype}, summed over the sizes and both sharings. Wrong: solved by its verdict, but with a gap over "
            f"{power(laws.gap)}, a backward error over {power(laws.balance)} or a violation over "
            f"{power(laws.violation)}; or infeasible by a certificate that proves less than {power(laws.need)} "
            f"loads to be needed. {_grant(laws)}*Against construction* counts feasible problems called infeasible and "
            "the reverse" + (" (rounding the data to float32 can make either of the other)." if laws.spread else ".")
        )
        text.append(_stress_table(list(group)))
    return "\n\n".join([*text, _unclean(rows)])


def _grant(laws: Laws) -> str:
    if not laws.spread:
        return ""
    return (
        "*Granted* counts, apart from the wrong, those that stand because of what rounding the data does: a gap no "
        "wider than one rounding of wrench and points makes it, or a backward error within "
        f"{power(laws.spread)} times the frame's distance over the contacts' extent. "
    )


def _stress_table(rows: list[dict]) -> str:
    sums = ["count", "solved", "infeasible", "not_converged", "wrong", "granted"]
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        kind_rows = [row for row in rows if row["kind"] == kind]
        worst = {
            key: max((r[key] for r in kind_rows if r[key] is not None), default=None)
            for key in ("max_gap", "max_backward_error", "max_violation")
        }
        need = min((r["min_need"] for r in kind_rows if r["min_need"] is not None), default=None)
        against = sum(r["infeasible_though_made_feasible"] + r["solved_though_made_infeasible"] for r in kind_rows)
        totals = [sum(row[key] for row in kind_rows) for key in sums]
        nobody = sum(row["verdicts"].get("NO_CONTACTS", 0) for row in kind_rows)
        lines.append([kind, *totals, nobody, against, *map(power, worst.values()), power(need)])
    head = ["kind", "problems", "solved", "infeasible", "not converged", "wrong", "granted"]
    head += ["no contacts", "against construction"]
    return table([*head, "worst gap", "backward error", "violation", "weakest proof, loads"], lines)


def _unclean(rows: list[dict]) -> str:
    """List every cell that holds wrong or unconverged answers."""
    keys = ["not_converged", "wrong", "infeasible_though_made_feasible", "solved_though_made_infeasible"]
    where = ["kind", "n", "sharing", "dtype"]
    lines = [[row[key] for key in where + keys] for row in rows if any(row[key] for key in keys)]
    if not lines:
        return "No cell holds a wrong or unconverged answer."
    return "Cells that hold wrong or unconverged answers:\n\n" + table(where + keys, lines)


def _decisions(rows: list[dict]) -> str:
    names = list(dict.fromkeys(row["method"] for row in rows))
    cells = {(row["method"], row["kind"]): row for row in rows}
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        shown = []
        for name in names:
            row = cells[name, kind]
            shown.append("raised" if "raised" in row else " / ".join(str(row[key]) for key in DECIDED))
        lines.append([kind, *shown])
    totals = [[sum(row.get(key, 0) for row in rows if row["method"] == name) for key in DECIDED] for name in names]
    lines.append(["all", *(" / ".join(map(str, total)) for total in totals)])
    where = f"of {rows[0]['count']} problems a kind at n = {rows[0]['n']}, method B"
    return "\n\n".join(
        [
            "## What rivals decide",
            f"Right / silently wrong / failed and said so, {where}. An answer is right within 100 of its "
            "method's own tolerances (at least 1e-6) in backward error, cone violation and, for circular cones, "
            "objective; claiming a feasible problem to be infeasible is wrong, and of an infeasible one only that "
            "claim is right. Pyramids need only be allowed. In float64: the section above has float32.",
            table(["kind", *names], lines),
        ]
    )


def _gradients(rows: list[dict]) -> str:
    keys = ["median_difference_from_finite", "max_difference_from_finite"]
    keys += ["median_difference_from_jacfwd", "max_difference_from_jacfwd"]
    lines = [[r["method"], f"{r['microseconds']:,.3g}", *(power(r[key]) for key in keys)] for r in rows]
    head = ["method", "µs a Jacobian", "from Clarabel's differences, median", "worst", "from jacfwd, median", "worst"]
    return "\n\n".join(
        [
            "## Derivatives",
            f"The Jacobian of the forces by the squeezing forces, which are the weights too: n = {rows[0]['n']}, "
            f"{rows[0]['count']} ordinary problems, {rows[0]['active']} with an active cone, each solved anew. Ours in "
            "one batch, the others in a loop. Differences are relative to the largest entry; Clarabel's central "
            "differences, at a step of 1e-4, are an independent but rough oracle.",
            table(head, lines),
        ]
    )
