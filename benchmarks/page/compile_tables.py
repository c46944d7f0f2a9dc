"""The page of compile times in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import made_by, table


def page(report: dict) -> str:
    parts = ["# Compiling", made_by("compile", report["machine"], ("jaxgrasp", "jax")) + "."]
    writers = {"programs": _programs, "verdicts": _verdicts, "kernels": _kernels, "suite": _suite}
    parts += [write(report[name]) for name, write in writers.items() if name in report]
    return "\n\n".join(parts) + "\n"


def _programs(rows: list[dict]) -> str:
    rows_by_program = {(row["call"], row["batch"], row["version"]): row for row in rows}
    lines = []
    for call, batch in dict.fromkeys((row["call"], row["batch"]) for row in rows):
        before, after = rows_by_program[call, batch, "before"], rows_by_program[call, batch, "after"]
        line: list[object] = [call, batch]
        for name in ("inside", "alone"):
            ratio = after[name] / before[name]
            line += [f"{before[name]:.1f}", f"{after[name]:.1f}", f"{ratio:.2f}"]
        lines.append([*line, before["fusions"], after["fusions"]])
    head = ["call", "batch", "inside: before", "after", "ratio", "alone: before", "after", "ratio", "fusions", "after"]
    return (
        "## First calls\n\n"
        "CPU seconds, n = 5, nothing cached: inside a program of the user's own (tracing, lowering and compiling of "
        "`jax.jit(call)`), and alone (the first call, outside of any). Fusions are those of the first. Before is "
        "commit be510ef, measured in turn with it.\n\n" + table(head, lines)
    )


def _verdicts(columns: dict[str, dict[str, list[int]]]) -> str:
    kinds = list(next(iter(columns.values())))
    lines = [
        [kind, next(iter(columns.values()))[kind][0], *(column[kind][1] for column in columns.values())]
        for kind in kinds
    ]
    return (
        "## Verdicts do not hang on how XLA compiles\n\n"
        "Problems that stay NOT_CONVERGED, n = 1 to 20, both sharings.\n\n"
        + table(["kind", "problems", *columns], lines)
    )


def _kernels(rows: list[dict]) -> str:
    lines = [
        [r["call"], r["n"], f"{r['single']:.2f}", f"{r['plain']:.2f}", f"{r['plain'] / r['single']:.2f}"] for r in rows
    ]
    return (
        "## Steps as single kernels\n\n"
        f"Microseconds a problem, jitted batches of {rows[0]['problems']:,} ordinary problems; plain is what another "
        "version of XLA gets until it is checked (`is_known_xla`).\n\n"
        + table(["call", "n", "single kernels", "plain", "ratio"], lines)
    )


def _suite(seconds: dict[str, float]) -> str:
    lines = [[folder, f"{spent:.0f}"] for folder, spent in sorted(seconds.items(), key=lambda item: -item[1])]
    lines.append(["all", f"{sum(seconds.values()):.0f}"])
    return "## The quick tests\n\nCPU seconds in one process, nothing cached.\n\n" + table(["folder", "s"], lines)
