"""The tables of README and of the page about speed, from the committed results.

    python -m benchmarks.readme

Each table stands between ``<!-- NAME table -->`` and ``<!-- end table -->``; a test holds both files to what this
writes.
"""

import json
import re
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from textwrap import fill

from benchmarks.page import suite_tables
from benchmarks.page.tables import NOTHING, power, table

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
OURS = "jaxgrasp constrained_optimum float64"
RIVALS = {
    "jaxgrasp closed_form float64": "`closed_form`: friction not imposed",
    OURS: "**`constrained_optimum`**",
    "jaxgrasp constrained_optimum float32": "the same in float32",
    "optimistix Newton 1e-08": "our dual by optimistix Newton, 1e-8",
    "jaxopt BoxOSQP pyramid of 8 1e-06": "8-sided pyramids by jaxopt BoxOSQP, 1e-6",
    "qpax pyramid of 8 1e-06": "8-sided pyramids by qpax, 1e-6",
    "Clarabel updated 1e-08": "Clarabel, updated in place, 1e-8",
    "Clarabel updated 1e-12": "the same, 1e-12",
    "Moreau 1e-08": "Moreau, batched, 1e-8",
    "QOCO updated 1e-08": "QOCO, updated in place, 1e-8",
    "ECOS 1e-08": "ECOS, 1e-8",
    "SCS 1e-09": "SCS, 1e-9",
}
"""Those of the page's methods that are shown, and what they are called."""
RIVALS_CONTACTS = 5


def result(name: str) -> dict:
    return json.loads((RESULTS / f"{name}.json").read_text())


def by_size() -> str:
    """Tabulate our two answers beside plain Cholesky, by the number of contacts."""
    plain = {(r["method"], r["dtype"], r["n"], r["batch"]): r for r in result("closed_form")["timings"]}
    page = result("constrained_optimum")
    rows = [row for row in page["singles"] + page["batches"] if row["method"] == OURS]
    # Of several batches the largest, which is last.
    lifts = {row["n"]: row for row in result("mixed")["families"] if row["load"] == "lift"}
    lines = []
    for n in sorted({row["n"] for row in rows}):
        microseconds = {(row["cell"], row.get("which")): row["microseconds"] for row in rows if row["n"] == n}
        cells: list[object] = [n]
        for method in ("plain Cholesky", "closed_form"):
            few, many = (plain[method, "float64", n, batch] for batch in (1_000, 100_000))
            cells.append(f"{few['microseconds']:.2f} / {many['microseconds']:.2f}")
        cells.append(f"{microseconds['batch 1000', None]:.1f} / {microseconds['batch 100000', None]:.1f}")
        cells.append(f"{lifts[n]['microseconds']['ours']:.1f} ({lifts[n]['infeasible']:.0%})")
        cells.append(
            f"{microseconds['single', 'closed form optimal']:.0f} / {microseconds['single', 'cones active']:.0f}"
        )
        lines.append(cells)
    batches = "batch of 1,000 / 100,000"
    head = ["n", *(f"{title}, {batches}" for title in ("plain Cholesky", "closed form", "optimum"))]
    head += ["optimum, sampled lifts (share that cannot hold)"]
    head += ["optimum, one call: closed form optimal / cones active"]
    return table(head, lines)


def by_rival() -> str:
    """Tabulate every method on the same problems of five contacts: time, error, and its wrong answers to nasty ones."""
    page = result("constrained_optimum")
    rows = [row for row in page["singles"] + page["batches"] if row["n"] == RIVALS_CONTACTS]
    lines = []
    for method, label in RIVALS.items():
        method_rows = [row for row in rows if row["method"] == method]
        if not method_rows:
            continue
        single = next((row for row in method_rows if row.get("which") == "cones active"), None)
        batches = [row for row in method_rows if row["cell"] != "single"]
        first_batch = batches[0]
        decided = [row for row in page["decisions"] if row["method"] == method]
        totals = [sum(row.get(key, 0) for row in decided) for key in ("right", "wrong", "failed")]
        lines.append(
            [
                label,
                f"{single['microseconds']:,.0f}" if single else NOTHING,
                f"{min(row['microseconds'] for row in batches):,.3g}",
                *(power(first_batch[key]) for key in ("max_force_error", "max_gap", "max_violation")),
                f"{first_batch['solved']:,}",
                " / ".join(f"{total:,}" for total in totals) if decided else NOTHING,
            ]
        )
    count = sum(row["count"] for row in page["decisions"] if row["method"] == OURS)
    head = ["method, tolerance", "one call, cones active, µs", "best batch, µs a problem", "worst force error"]
    head += ["own duality gap", "cone violation", "solved of 1,000"]
    return table([*head, f"right / silently wrong / failed of {count:,}"], lines)


def throughput() -> str:
    """Return the table of grasps per second of ``jaxgrasp evaluate``."""
    shown = [
        [row["family"], f"{row['grasps']:,}", f"{row['grasps_per_second']:,.0f}", f"{row['peak_mib']:,.0f} MiB"]
        for row in result("evaluate")["rows"]
    ]
    return table(["family", "grasps of five contacts", "grasps per second", "peak memory"], shown)


def first_calls() -> str:
    """Return the table of first calls, each by itself and with nothing cached."""
    rows = [row for row in result("compile")["programs"] if row["version"] == "after"]
    seconds = {(row["call"], row["batch"]): row["alone"] for row in rows}
    shown = [
        [f"`{call}`" if call.isidentifier() else call, f"{seconds[call, 1]:.1f}", f"{seconds[call, 1000]:.1f}"]
        for call in dict.fromkeys(row["call"] for row in rows)
    ]
    return table(["call", "one problem, CPU seconds", "batch of 1,000"], shown)


def by_kernel() -> str:
    """Return the table of first calls with and without the compiled kernel, the first of its page."""
    lines = (RESULTS / "kernel.md").read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|"))
    return "\n".join(takewhile(lambda line: line.startswith("|"), lines[first:]))


def on_gpu() -> str:
    """Return the table of the optimum of five contacts on a GPU, by the size of the batch."""
    rows = {(row["batch"], row["dtype"]): row for row in result("accelerator")["batches"]}
    shown = [
        [f"{batch:,}", *(f"{rows[batch, dtype]['per_second'] / 1e6:.3g}" for dtype in ("float32", "float64"))]
        for batch in dict.fromkeys(batch for batch, _ in rows)
    ]
    return table(["batch", "float32, millions a second", "float64"], shown)


def by_suite() -> str:
    """Return the sentences on the suite of hard problems."""
    return fill(suite_tables.line(result("suite")), 120, break_on_hyphens=False)


TABLES: dict[str, dict[str, Callable[[], str]]] = {
    "README.md": {"size": by_size, "suite": by_suite},
    "docs/speed.md": {
        "rival": by_rival,
        "first call": first_calls,
        "kernel": by_kernel,
        "throughput": throughput,
        "gpu": on_gpu,
    },
}
"""By the file that they stand in."""


def filled(file: str) -> str:
    """Return a file's text with its tables filled in from the results."""
    text = (ROOT / file).read_text()
    for name, make in TABLES[file].items():
        pattern = re.compile(rf"(<!-- {name} table -->\n).*?(<!-- end table -->)", re.S)
        text, n_places = pattern.subn(lambda match, make=make: match[1] + make() + "\n" + match[2], text)
        if n_places != 1:
            raise ValueError(f"{file} has {n_places} places for the {name} table: expected 1")
    return text


def main() -> None:
    for file in TABLES:
        (ROOT / file).write_text(filled(file))


if __name__ == "__main__":
    main()
