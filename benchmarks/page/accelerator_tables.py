"""The page of batches on a GPU in Markdown, from the report that the JSON holds too."""

from collections.abc import Callable, Iterable
from typing import Any

from benchmarks.page.tables import by_size, table

DTYPES = ("float32", "float64")
SPEED = (
    "Ordinary problems, all of which can be solved, half of them with cones that bind. Millions of problems a second: "
    "jitted, data on the device, medians, forces and verdicts made. A batch repeats 10,000 different problems."
)
BATCHES = (
    "The optimum of five contacts: milliseconds a call, and millions of problems a second. Some problems are too "
    "ill-conditioned for float32, and the careful passes that they need hold up small batches."
)
MIXED = (
    "Contacts at random on a unit sphere that press inward; any wrench, or a lift by the upper half alone, as on "
    "[the page of mixed batches](mixed.md). Float64. Undecided are those NOT_CONVERGED."
)
GRADIENTS = (
    "The gradient of the sum of squared forces by places, normals, friction, squeeze and wrench, the optimum included: "
    "millions of problems a second."
)
COPIES = "From NumPy's arrays to NumPy's arrays, five contacts: what copies add."
FIRST_CALLS = "Tracing and compiling for five contacts in float64, nothing cached."
DECISIONS = (
    "Hard kinds in float64, by both sharings. Wrong is judged in extended precision by code that shares nothing with "
    "the solver. A contradiction is one device's answer against the other's proof."
)


def page(report: dict) -> str:
    facts = report["machine"]
    parts = [
        "# On a GPU",
        f"Made by `python -m benchmarks.accelerator` on {report['device']['kind']}, {facts['system']}, Python "
        f"{facts['python']}, jax {facts['versions']['jax']}; first calls left out.",
    ]
    # What whoever measured has to say of a section.
    remarks = {name: [text] for name, text in report.get("remarks", {}).items()}
    parts += remarks.get("device", [])
    for name, (title, about, write) in SECTIONS.items():
        if name in report:
            parts += [f"## {title}", about, *remarks.get(name, []), write(report[name])]
    return "\n\n".join(parts) + "\n"


def _millions(row: dict) -> str:
    return f"{row['per_second'] / 1e6:.3g}"


def _by_question(rows: Iterable[dict]) -> str:
    return by_size([row | {"asked": f"`{row['question']}`, {row['dtype']}"} for row in rows], "asked", _millions, "")


def _by_batch(rows: list[dict]) -> str:
    lines = []
    for batch in dict.fromkeys(row["batch"] for row in rows):
        rows_by_dtype = {row["dtype"]: row for row in rows if row["batch"] == batch}
        milliseconds = [f"{rows_by_dtype[dtype]['milliseconds']:.3g}" for dtype in DTYPES]
        lines.append([f"{batch:,}", *milliseconds, *(_millions(rows_by_dtype[dtype]) for dtype in DTYPES)])
    return table(["batch", *(f"{dtype}, {unit}" for unit in ("ms", "M/s") for dtype in DTYPES)], lines)


def _mixed(rows: list[dict]) -> str:
    lines = []
    for row in rows:
        share, undecided = (row["verdicts"].get(name, 0) for name in ("INFEASIBLE", "NOT_CONVERGED"))
        lines.append([row["n"], row["load"], f"{share / row['batch']:.1%}", f"{undecided:,}", _millions(row)])
    return table(["n", "load", "infeasible", "undecided", "M/s"], lines)


def _copies(rows: list[dict]) -> str:
    lines = [[row["dtype"], f"{row['milliseconds']:.0f}", _millions(row)] for row in rows]
    return table(["precision", "ms", "M/s"], lines)


def _first_calls(rows: list[dict]) -> str:
    return table(["call", "seconds"], [[f"`{row['question']}`", f"{row['seconds']:.0f}"] for row in rows])


def _decisions(rows: list[dict]) -> str:
    counts = ("count", "wrong", "contradict", "undecided", "undecided_by_processor", "verdicts_differ")
    head = ["kind", "problems", "wrong", "contradictions", "undecided", "by the processor", "verdicts differ"]
    kinds = dict.fromkeys(row["kind"] for row in rows)
    lines = [[kind, *(sum(row[name] for row in rows if row["kind"] == kind) for name in counts)] for kind in kinds]
    return table(head, [*lines, ["all", *(sum(row[name] for row in rows) for name in counts)]])


SECTIONS: dict[str, tuple[str, str, Callable[[Any], str]]] = {
    "speed": ("By the number of contacts", SPEED, _by_question),
    "batches": ("By the size of the batch", BATCHES, _by_batch),
    "mixed": ("Sampled grasps", MIXED, _mixed),
    "gradients": ("Gradients", GRADIENTS, _by_question),
    "copies": ("Copies", COPIES, _copies),
    "first_calls": ("First calls", FIRST_CALLS, _first_calls),
    "decisions": ("Verdicts", DECISIONS, _decisions),
}
"""Of the report: its title, what is said of it, and what is shown."""
