"""Batches on a GPU: problems a second by size and precision, sampled grasps, gradients, and the hard kinds' verdicts.

    python -m benchmarks.accelerator --out benchmarks/results

Writes accelerator.json and accelerator.md. It measures JAX's default device, whatever that is, and the page names it.
"""

import time
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.laws import decision_counts, verdict_counts
from benchmarks.page import accelerator_tables
from benchmarks.page.accelerator_tables import DTYPES
from benchmarks.page.clock import interleaved
from benchmarks.sampled_grasps import sampled
from benchmarks.sections import run_sections
from jaxgrasp import Grasp
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.references import Problems

NAME = "accelerator"
DIFFERENT = 10_000
"""Problems of a batch that differ; a larger batch repeats them, so that making them takes no longer than solving."""


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    batch: int = 1_000_000
    growing: tuple[int, ...] = (1_000, 10_000, 100_000, 10_000_000)
    """Batches of five contacts, beside the one of all sizes."""
    graded: tuple[int, ...] = (5, 10)
    """Sizes of which gradients are taken."""
    judged: tuple[int, ...] = (3, 5)
    """Sizes of the hard kinds."""
    count: int = 1_000
    """Of each hard kind."""
    repeats: int = 7
    budget: float = 10.0
    """Seconds after which a call is not repeated."""


def closed_form(*arrays: jax.Array) -> tuple[jax.Array, ...]:
    return _answers(jaxgrasp.closed_form, *arrays)


def constrained_optimum(*arrays: jax.Array) -> tuple[jax.Array, ...]:
    return _answers(jaxgrasp.constrained_optimum, *arrays)


def gradient(*arrays: jax.Array) -> tuple[jax.Array, ...]:
    """Return the gradient of the sum of the squared forces by every array."""

    def total(arrays: tuple[jax.Array, ...]) -> jax.Array:
        return jnp.sum(jaxgrasp.constrained_optimum(Grasp(*arrays[:4]), arrays[4]).forces ** 2)

    return jax.grad(total)(arrays)


class Claims(NamedTuple):
    """Claims and proofs of an answer."""

    forces: jax.Array
    multiplier: jax.Array
    certificate: jax.Array
    verdict: jax.Array


def weighted_optimum(*arrays: jax.Array) -> Claims:
    *contacts, wrench, weights = arrays
    solution = jaxgrasp.constrained_optimum(Grasp(*contacts), wrench, weights)
    return Claims(*(getattr(solution, name) for name in Claims._fields))


def _answers(question: Callable, *arrays: jax.Array) -> tuple[jax.Array, ...]:
    solution = question(Grasp(*arrays[:4]), arrays[4])
    return solution.forces, solution.verdict


@cache
def compiled(question: Callable, n: int, batch: int, dtype: str, device: Any = None) -> Callable:
    """Compile the program for ``batch`` grasps of n contacts."""
    tails = [(n, 3), (n, 3), (n,), (n,), (6,)] + [(n,)] * (question is weighted_optimum)
    where = None if device is None else jax.sharding.SingleDeviceSharding(device)
    shapes = [jax.ShapeDtypeStruct((batch, *tail), dtype, sharding=where) for tail in tails]
    return jax.jit(question).lower(*shapes).compile()


def device_arrays(problem: Problems, batch: int, dtype: str) -> list[jax.Array]:
    """Put the problems on the device, repeated to a batch of that size."""
    return [jnp.asarray(np.resize(np.asarray(x, dtype), (batch, *x.shape[1:]))) for x in problem[1:6]]


def _seconds(call: Callable[[], Any], plan: Plan) -> float:
    """Return the median seconds of several calls, after one that is not counted."""
    return interleaved({call: lambda: jax.block_until_ready(call())}, plan.repeats, plan.budget)[call]


def _row(question: Callable, problem: Problems, batch: int, dtype: str, plan: Plan) -> dict:
    n, arrays = problem.points.shape[1], device_arrays(problem, batch, dtype)
    program = compiled(question, n, batch, dtype)
    seconds_per_batch = _seconds(lambda: program(*arrays), plan)
    row = {
        "question": question.__name__,
        "load": problem.kind,
        "n": n,
        "batch": batch,
        "dtype": dtype,
        "milliseconds": 1e3 * seconds_per_batch,
        "per_second": batch / seconds_per_batch,
    }
    if question is gradient:
        return row
    return row | {"verdicts": verdict_counts(np.asarray(program(*arrays)[1]))}


def _ordinary(n: int, batch: int) -> Problems:
    return P.problems("ordinary", n, min(batch, DIFFERENT), seed=5)


def speed(plan: Plan) -> list[dict]:
    """Measure both answers to ordinary problems of every size."""
    return [
        _row(question, _ordinary(n, plan.batch), plan.batch, dtype, plan)
        for question in (closed_form, constrained_optimum)
        for n in plan.sizes
        for dtype in DTYPES
    ]


def batches(plan: Plan) -> list[dict]:
    """Measure the optimum of five contacts by the size of the batch."""
    return [
        _row(constrained_optimum, _ordinary(5, batch), batch, dtype, plan)
        for batch in sorted({*plan.growing, plan.batch})
        for dtype in DTYPES
    ]


def mixed(plan: Plan) -> list[dict]:
    """Measure sampled grasps, many of which cannot hold their load."""
    return [
        _row(constrained_optimum, sampled(n, min(plan.batch, DIFFERENT), lift), plan.batch, "float64", plan)
        for n in plan.sizes
        for lift in (False, True)
    ]


def gradients(plan: Plan) -> list[dict]:
    """Measure the reverse derivative of ordinary problems, together with their optimum."""
    return [_row(gradient, _ordinary(n, plan.batch), plan.batch, dtype, plan) for n in plan.graded for dtype in DTYPES]


def copies(plan: Plan) -> list[dict]:
    """Measure the optimum of five contacts from NumPy's arrays to NumPy's arrays."""
    rows = []
    for dtype in DTYPES:
        program = compiled(constrained_optimum, 5, plan.batch, dtype)
        arrays = jax.device_get(device_arrays(_ordinary(5, plan.batch), plan.batch, dtype))
        seconds_per_batch = _seconds(lambda program=program, arrays=arrays: jax.device_get(program(*arrays)), plan)
        rows.append(
            {
                "dtype": dtype,
                "batch": plan.batch,
                "milliseconds": 1e3 * seconds_per_batch,
                "per_second": plan.batch / seconds_per_batch,
            }
        )
    return rows


def first_calls(plan: Plan) -> list[dict]:
    """Measure a first call before it computes anything: tracing and compiling, nothing cached."""
    rows = []
    for question in (closed_form, constrained_optimum, gradient):
        jax.clear_caches()
        start = time.perf_counter()
        compiled.__wrapped__(question, 5, plan.batch, "float64")
        rows.append({"question": question.__name__, "seconds": time.perf_counter() - start})
    return rows


def decisions(plan: Plan) -> list[dict]:
    """Judge every hard kind in double precision by extended precision, and compare with the processor's answers."""
    return [row for n in plan.judged for row in _decisions_of_size(n, plan)]


def _decisions_of_size(n: int, plan: Plan) -> Iterator[dict]:
    questions = [
        (P.problems(kind, n, plan.count, seed=0), sharing)
        for kind in P.KINDS
        if n >= P.LEAST_CONTACTS.get(kind, 1)
        for sharing in ("squeeze", "uniform")
    ]
    arrays = [
        np.concatenate([(*problem[1:6], problem.weights(sharing))[i] for problem, sharing in questions])
        for i in range(6)
    ]
    batch = len(arrays[0])
    on_device, on_cpu = (
        jax.device_get(compiled(weighted_optimum, n, batch, "float64", device)(*jax.device_put(arrays, device)))
        for device in (jax.devices()[0], jax.devices("cpu")[0])
    )
    for i, (problem, sharing) in enumerate(questions):
        rows = slice(i * plan.count, (i + 1) * plan.count)
        device_rows, cpu_rows = (jax.tree.map(lambda x, rows=rows: x[rows], answer) for answer in (on_device, on_cpu))
        yield {"kind": problem.kind, "n": n, "sharing": sharing, "count": plan.count} | _decision_counts(
            problem, problem.weights(sharing), device_rows, cpu_rows
        )


def _decision_counts(problem: Problems, weights: np.ndarray, on_device: Claims, on_cpu: Claims) -> dict:
    counts = decision_counts(problem, weights, on_device, on_cpu)
    return counts | {"undecided_by_processor": counts.pop("undecided_by_reference")}


def device(plan: Plan) -> dict:
    """Return the device that was measured."""
    first_device = jax.devices()[0]
    return {"platform": first_device.platform, "kind": first_device.device_kind}


SECTIONS = {
    "device": device,
    "speed": speed,
    "batches": batches,
    "mixed": mixed,
    "gradients": gradients,
    "copies": copies,
    "decisions": decisions,
    "first_calls": first_calls,
}
QUICK = Plan(sizes=(5,), batch=100, growing=(), graded=(5,), judged=(5,), count=8, repeats=2)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), accelerator_tables.page)


if __name__ == "__main__":
    main()
