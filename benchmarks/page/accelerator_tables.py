"""The page of batches on a GPU in Markdown, from the report that the JSON holds too."""

from collections.abc import Iterable

from benchmarks.page.tables import by_size, table

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
        *_remark(report, "programs"),
    ]
    if "speed" in report:
        parts += ["## By the number of contacts", SPEED, *_remark(report, "speed"), _by_question(report["speed"])]
    if "batches" in report:
        head = ["batch", "float32, ms", "float64, ms", "float32, M/s", "float64, M/s"]
        parts += ["## By the size of the batch", BATCHES, table(head, _by_batch(report["batches"]))]
    if "mixed" in report:
        head = ["n", "load", "infeasible", "undecided", "M/s"]
        parts += ["## Sampled grasps", MIXED, table(head, map(_mixed, report["mixed"]))]
    if "gradients" in report:
        parts += ["## Gradients", GRADIENTS, _by_question(report["gradients"])]
    if "copies" in report:
        rows = [[row["dtype"], f"{row['milliseconds']:.0f}", _millions(row)] for row in report["copies"]]
        parts += ["## Copies", COPIES, table(["precision", "ms", "M/s"], rows)]
    if "first_calls" in report:
        rows = [[f"`{row['question']}`", f"{row['seconds']:.0f}"] for row in report["first_calls"]]
        parts += ["## First calls", FIRST_CALLS, table(["call", "seconds"], rows)]
    if "decisions" in report:
        parts += ["## Verdicts", DECISIONS, _decisions(report["decisions"])]
    return "\n\n".join(parts) + "\n"


def _remark(report: dict, about: str) -> list[str]:
    """What whoever measured has to say of a part of the report."""
    return [text for text in [report.get("remarks", {}).get(about)] if text]


def _millions(row: dict) -> str:
    return f"{row['per_second'] / 1e6:.3g}"


def _by_question(rows: Iterable[dict]) -> str:
    return by_size([row | {"asked": f"`{row['question']}`, {row['dtype']}"} for row in rows], "asked", _millions, "")


def _by_batch(rows: list[dict]) -> Iterable[list[str]]:
    for batch in dict.fromkeys(row["batch"] for row in rows):
        single, double = ({row["dtype"]: row for row in rows if row["batch"] == batch}[name] for name in DTYPES)
        took = [f"{row['milliseconds']:.3g}" for row in (single, double)]
        yield [f"{batch:,}", *took, _millions(single), _millions(double)]


DTYPES = ("float32", "float64")


def _mixed(row: dict) -> list[str]:
    share, open_ = row["verdicts"].get("INFEASIBLE", 0) / row["batch"], row["verdicts"].get("NOT_CONVERGED", 0)
    return [str(row["n"]), row["load"], f"{share:.1%}", f"{open_:,}", _millions(row)]


def _decisions(rows: list[dict]) -> str:
    counts = ("count", "wrong", "contradict", "undecided", "undecided_by_processor", "verdicts_differ")
    head = ["kind", "problems", "wrong", "contradictions", "undecided", "by the processor", "verdicts differ"]
    kinds = dict.fromkeys(row["kind"] for row in rows)
    lines = [[kind, *(sum(row[name] for row in rows if row["kind"] == kind) for name in counts)] for kind in kinds]
    return table(head, [*lines, ["all", *(sum(row[name] for row in rows) for name in counts)]])
