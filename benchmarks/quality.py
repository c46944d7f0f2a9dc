"""Measures of quality: what each costs, how bounds of the balls of wrenches close, and what pyramids miss.

    python -m benchmarks.quality --out benchmarks/results

Ordinary grasps that are closed, and batches of random ones. Writes quality.json and quality.md.
"""

from benchmarks.one_thread import one_thread

one_thread()

import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial import ConvexHull

import jaxgrasp
from benchmarks.page import quality_tables
from benchmarks.sections import run_sections
from jaxgrasp import Grasp
from jaxgrasp.problem.wrench_discs import discs
from jaxgrasp.quality.wrench_sets import pyramid
from jaxgrasp.testing import problems as P

NAME = "quality"
SIDES = (4, 8, 16)
KINDS = ("ordinary", "near_collinear", "low_friction", "zero_friction", "far_frame", "combined")


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    grasps: int = 8
    points: tuple[int, ...] = (25, 50, 100, 200, 400)
    decided: int = 200
    batch: int = 200
    many: int = 2000
    """Grasps in one call of measures that take some microseconds."""
    hulls: int = 8
    """Grasps of each size by Qhull, one after the other."""


def closed_grasps(n: int, count: int) -> tuple[Grasp, np.ndarray]:
    """Return the first closed ones among ordinary grasps, and their wrenches."""
    problem = P.problems("ordinary", n, 12 * count, seed=7)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    closed = np.flatnonzero(jaxgrasp.quality.force_closure(grasp).closed)[:count]
    return jax.tree.map(lambda array: array[closed], grasp), problem.wrench[closed]


def alone(grasp: Grasp, index: int) -> Grasp:
    return jax.tree.map(lambda array: array[index], grasp)


def spent(measure: Callable, grasp: Grasp, *arguments: np.ndarray) -> list[float]:
    """Measure the CPU seconds of each grasp, one call after the other; a first call compiles."""
    count, seconds = len(grasp.points), []
    measure(alone(grasp, 0), *(argument[0] for argument in arguments))
    for index in range(count):
        start = time.process_time()
        jax.block_until_ready(measure(alone(grasp, index), *(argument[index] for argument in arguments)))
        seconds.append(time.process_time() - start)
    return seconds


def times(plan: Plan) -> list[dict]:
    rows = []
    for n in plan.sizes:
        grasp, wrench = closed_grasps(n, plan.grasps)
        calls: dict[str, tuple] = {
            "force_closure": (jaxgrasp.quality.force_closure,),
            "ferrari_canny, l1": (jaxgrasp.quality.ferrari_canny,),
            "ferrari_canny, l1, 8 sides": (partial(jaxgrasp.quality.ferrari_canny, sides=8),),
            "ferrari_canny, linf": (partial(jaxgrasp.quality.ferrari_canny, bound="linf"),),
            "ferrari_canny, linf, 8 sides": (partial(jaxgrasp.quality.ferrari_canny, bound="linf", sides=8),),
            "largest_wrench, l1": (partial(jaxgrasp.quality.largest_wrench, bound="l1"), wrench),
            "largest_wrench, linf": (jaxgrasp.quality.largest_wrench, wrench),
            "min_weight, 4 sides": (jaxgrasp.quality.min_weight,),
            "singular_values": (jaxgrasp.quality.singular_values,),
        }
        for name, (measure, *others) in calls.items():
            seconds = spent(measure, grasp, *others)
            rows.append({"n": n, "measure": name, "median": float(np.median(seconds)), "largest": max(seconds)})
    return rows


def round_about(n: int, count: int) -> Grasp:
    """Return contacts anywhere on a unit ball, closed or not, with friction 0.5."""
    outward = np.random.default_rng(0).normal(size=(count, n, 3))
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    unit = np.ones((count, n))
    return Grasp(outward, -outward, 0.5 * unit, unit)


def batches(plan: Plan) -> list[dict]:
    """Measure the CPU time of a grasp in one call for many, and that of Qhull on their pyramids."""
    rows = []
    for n in plan.sizes:
        few, many = round_about(n, plan.batch), round_about(n, plan.many)
        task = np.random.default_rng(1).normal(size=(plan.many, 6))
        ball = partial(jaxgrasp.quality.ferrari_canny, few, **unit_frame(plan.batch))
        frame = unit_frame(plan.many)
        calls: dict[str, tuple[int, Callable]] = {
            "force_closure": (plan.many, partial(jaxgrasp.quality.force_closure, many, **frame)),
            "ferrari_canny, l1, 1e-2": (plan.batch, partial(ball, "l1", tol=1e-2)),
            "ferrari_canny, l1, 1e-3": (plan.batch, partial(ball, "l1")),
            "ferrari_canny, l1, 8 sides": (plan.batch, partial(ball, "l1", sides=8)),
            "ferrari_canny, linf, 1e-2": (plan.batch, partial(ball, "linf", tol=1e-2)),
            "largest_wrench, l1": (plan.many, partial(jaxgrasp.quality.largest_wrench, many, task, "l1")),
            "largest_wrench, linf": (plan.many, partial(jaxgrasp.quality.largest_wrench, many, task)),
            "min_weight, 4 sides": (plan.many, partial(jaxgrasp.quality.min_weight, many)),
            "singular_values": (plan.many, partial(jaxgrasp.quality.singular_values, many, **frame)),
        }
        for name, (count, call) in calls.items():
            call()
            start = time.process_time()
            jax.block_until_ready(call())
            rows.append({"n": n, "measure": name, "seconds": (time.process_time() - start) / count})
        rows.append({"n": n, "measure": "Qhull, 8 sides", "seconds": by_qhull(few, plan.hulls)})
    return rows


def unit_frame(count: int) -> dict[str, np.ndarray]:
    return {"length": np.ones(count), "about": np.zeros((count, 3))}


def by_qhull(grasp: Grasp, count: int) -> float:
    """Return the median CPU time of the hull of a grasp's wrenches."""
    shapes = discs(grasp, 1.0, np.zeros(3))
    leans = np.einsum("gnjk,ck->gncj", np.asarray(shapes.spans), pyramid(8, False))
    seconds = []
    for wrenches in (np.asarray(shapes.centres)[:, :, None] + leans)[:count]:
        start = time.process_time()
        ConvexHull(wrenches.reshape(-1, 6))
        seconds.append(time.process_time() - start)
    return float(np.median(seconds))


def gaps(plan: Plan) -> list[dict]:
    """Measure the gap between the bounds when a search may take only so many points."""
    rows = []
    for n in plan.sizes:
        grasp, _ = closed_grasps(n, plan.grasps)
        for bound in ("l1", "linf"):
            for points in plan.points:
                start = time.process_time()
                bounds = jaxgrasp.quality.ferrari_canny(grasp, bound, tol=1e-4, max_points=points)
                seconds = (time.process_time() - start) / plan.grasps
                gap = 1 - bounds.lower / bounds.upper
                figures = {"median": float(np.median(gap)), "largest": float(gap.max()), "seconds": seconds}
                rows.append({"n": n, "bound": bound, "points": points, **figures})
    return rows


def pyramids(plan: Plan) -> list[dict]:
    """Compare the balls of pyramids with the cones': by how much they are smaller, relative to the cones'."""
    rows = []
    for n in plan.sizes:
        grasp, _ = closed_grasps(n, plan.grasps)
        for bound in ("l1", "linf"):
            exact = jaxgrasp.quality.ferrari_canny(grasp, bound)
            for sides in SIDES:
                bounds = jaxgrasp.quality.ferrari_canny(grasp, bound, sides=sides)
                short = 1 - bounds.upper / exact.upper
                figures = {"median": float(np.median(short)), "largest": float(short.max())}
                rows.append({"n": n, "bound": bound, "sides": sides, **figures})
    return rows


def decisions(plan: Plan) -> list[dict]:
    """Count the closed, open and undecided grasps of every kind."""
    rows = []
    for kind in KINDS:
        for n in plan.sizes:
            problem = P.problems(kind, n, plan.decided, seed=7)
            grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
            closure = jaxgrasp.quality.force_closure(grasp)
            closed, undecided = int(closure.closed.sum()), int((~closure.decided).sum())
            counts = {"closed": closed, "open": plan.decided - closed - undecided, "undecided": undecided}
            rows.append({"kind": kind, "n": n, **counts})
    return rows


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    sections = {"batches": batches, "times": times, "gaps": gaps, "pyramids": pyramids, "decisions": decisions}
    plans = Plan(), Plan(sizes=(3, 5), grasps=2, points=(25, 50), decided=10, batch=10, many=10, hulls=2)
    run_sections(__doc__, NAME, sections, plans, quality_tables.page)


if __name__ == "__main__":
    main()
