"""Time and error of the closed form, jitted and called plainly, beside a batch-first Cholesky; failures included.

    python -m benchmarks.closed_form --out benchmarks/results/closed_form.json

The whole public call is timed, with residual, verdict, objective and certificate; the rival computes forces alone.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.machine import machine
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

SIZES, BATCHES, DTYPES = (3, 5, 10, 20), (1_000, 12_345, 100_000), (np.float64, np.float32)
"""Of the batches one is no multiple of anything: outside jit it is padded."""
ERROR_LIMIT = {"float64": 1e-6, "float32": 1e-2}
RESIDUAL_LIMIT = {"float64": 1e-10, "float32": 1e-4}
"""A user who looks at the residual distrusts an answer above this."""
STRESS_SIZE, STRESS_COUNT = 5, 1_000


def outside_jit(problem) -> jaxgrasp.Solution:
    points, normals, friction, squeeze, wrench = problem
    return jaxgrasp.closed_form(Grasp(points, normals, friction, squeeze), wrench, squeeze)


ours = jax.jit(outside_jit)


@jax.jit
def cholesky(problem) -> jax.Array:
    """Compute eq. 15 as one writes it at first: batch-first, G W G^T whole, about the frame's own origin."""
    points, normals, _, squeeze, wrench = problem
    matrix = jaxgrasp.grasp_matrix(points)
    weights = jnp.repeat(squeeze, 3, -1)
    squeezing = (squeeze[..., None] * normals).reshape(weights.shape)
    gram = jnp.einsum("bij,bj,bkj->bik", matrix, weights, matrix)
    residual_wrench = wrench - jnp.einsum("bij,bj->bi", matrix, squeezing)
    multiplier = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(gram), True), residual_wrench[..., None])[..., 0]
    forces = squeezing + weights * jnp.einsum("bij,bi->bj", matrix, multiplier)
    return forces.reshape(points.shape)


METHODS: dict[str, Callable] = {"closed_form": ours, "closed_form outside jit": outside_jit, "plain Cholesky": cholesky}


def arrays(problem: P.Problems) -> tuple:
    return tuple(jax.device_put(getattr(problem, name)) for name in R.ARRAYS)


def force_error(problem: P.Problems, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest error of a problem's forces relative to its largest force, and the reference's rank."""
    expected, rank = R.closed_form_reference(problem, problem.squeeze)
    largest = np.sqrt(np.sum(expected**2, -1)).max(-1)
    distances = np.sqrt(np.sum((np.asarray(forces) - expected) ** 2, -1)).max(-1)
    return np.asarray(distances / np.where(largest > 0, largest, 1), float), rank


def timings(repeats: int) -> list[dict]:
    rows = []
    for dtype in DTYPES:
        for n in SIZES:
            for batch in BATCHES:
                problem = P.problems("ordinary", n, batch, seed=0).cast(dtype)
                rows += time_one(problem, np.dtype(dtype).name, n, batch, repeats)
    return rows


def time_one(problem: P.Problems, dtype: str, n: int, batch: int, repeats: int) -> list[dict]:
    """Measure rivals in turns in one process, so that the machine's load hits both."""
    data = arrays(problem)
    seconds: dict[str, list[float]] = {name: [] for name in METHODS}
    for method in METHODS.values():
        jax.block_until_ready(method(data))
    for _ in range(repeats):
        for name, method in METHODS.items():
            start = time.perf_counter()
            jax.block_until_ready(method(data))
            seconds[name].append(time.perf_counter() - start)
    checked = problem._replace(**{name: getattr(problem, name)[:1_000] for name in R.ARRAYS})
    rows = []
    for name, method in METHODS.items():
        answer = jax.device_get(method(data))
        forces = getattr(answer, "forces", answer)[:1_000]
        error, _ = force_error(checked, forces)
        rows.append(
            {
                "method": name,
                "dtype": dtype,
                "n": n,
                "batch": batch,
                "threads": 1,
                "microseconds": float(np.median(seconds[name])) / batch * 1e6,
                "median_error": float(np.median(error)),
                "max_error": float(np.max(np.nan_to_num(error, nan=np.inf))),
                "verdicts": counts(answer.verdict) if hasattr(answer, "verdict") else None,
            }
        )
    return rows


def errors() -> list[dict]:
    rows = []
    for dtype in DTYPES:
        name = np.dtype(dtype).name
        for kind in P.KINDS:
            problem = P.problems(kind, STRESS_SIZE, STRESS_COUNT, seed=0).cast(dtype)
            answer, rival = jax.device_get((ours(arrays(problem)), cholesky(arrays(problem))))
            error, rank = force_error(problem, answer.forces)
            rival_error, _ = force_error(problem, rival)
            answered = answer.verdict <= Verdict.OUTSIDE_CONES
            silent = answered & (answer.residual <= RESIDUAL_LIMIT[name]) & ~(error <= ERROR_LIMIT[name])
            rows.append(
                {
                    "kind": kind,
                    "dtype": name,
                    "n": STRESS_SIZE,
                    "count": STRESS_COUNT,
                    "answered": int(answered.sum()),
                    "median_error": float(np.median(error[answered])) if answered.any() else None,
                    "max_error": float(error[answered].max()) if answered.any() else None,
                    "max_residual": float(answer.residual[answered].max()) if answered.any() else None,
                    "wrong_and_unflagged": int(silent.sum()),
                    "of_these_with_reduced_rank": int((silent & (answer.rank < rank)).sum()),
                    "rival_wrong": int((~(rival_error <= ERROR_LIMIT[name])).sum()),
                    "verdicts": counts(answer.verdict),
                }
            )
    return rows


def counts(verdicts: np.ndarray) -> dict[str, int]:
    return {Verdict(int(v)).name: int((verdicts == v).sum()) for v in np.unique(verdicts)}


def markdown(report: dict) -> str:
    head = ("dtype", "n", "batch", *(f"{name} µs" for name in METHODS), "max error", "Cholesky's max error")
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    cells: dict[tuple, dict[str, dict]] = {}
    for row in report["timings"]:
        cells.setdefault((row["dtype"], row["n"], row["batch"]), {})[row["method"]] = row
    for (dtype, n, batch), by_method in cells.items():
        times = " | ".join(f"{by_method[name]['microseconds']:.3f}" for name in METHODS)
        mine, cholesky_error = by_method["closed_form"]["max_error"], by_method["plain Cholesky"]["max_error"]
        lines.append(f"| {dtype} | {n} | {batch:,} | {times} | {mine:.1e} | {cholesky_error:.1e} |")
    lines += [
        "",
        "| kind | dtype | answered | median error | max error | max residual | wrong, unflagged "
        "| of these rank < reference's | rival wrong |",
    ]
    lines.append("|" + "---|" * 9)
    for row in report["errors"]:
        shown = [
            f"{row[key]:.1e}" if row[key] is not None else "-" for key in ("median_error", "max_error", "max_residual")
        ]
        lines.append(
            f"| {row['kind']} | {row['dtype']} | {row['answered']} | {' | '.join(shown)} | "
            f"{row['wrong_and_unflagged']} | {row['of_these_with_reduced_rank']} | {row['rival_wrong']} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="where the JSON goes")
    parser.add_argument("--repeats", type=int, default=21)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report = {
        "machine": machine(),
        "error_limit": ERROR_LIMIT,
        "residual_limit": RESIDUAL_LIMIT,
        "extended_precision": bool(R.EXTENDED),
        "timings": timings(options.repeats),
        "errors": errors(),
    }
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(report, indent=1) + "\n")
    print(markdown(report))


if __name__ == "__main__":
    main()
