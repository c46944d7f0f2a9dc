"""The transforms around a flat batch solver: derivatives outside, then batching, then the solver itself.

``custom_jvp`` is outermost, so that every derivative comes from ``derivative.py`` and none from the loops
inside. ``custom_vmap`` flattens every mapped axis into the one batch that the solver gathers from; it sees
when only the wrenches are mapped, and then the grasp's own work is done once.
"""

from collections.abc import Callable
from dataclasses import fields
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap

from jaxgrasp.model.solution import Solution
from jaxgrasp.numerics.zero_tangent import zero_tangent
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import by_optimistix, derivative, passes
from jaxgrasp.solver.result import PassResult

FlatSolver = Callable[[ProblemBatch], Solution]
"""A differentiable solver of a flat batch."""
SOLUTION = tuple(field.name for field in fields(Solution))
"""The names of its fields."""
PER_WRENCH = ("wrench", "start")
"""What each of many wrenches that share a grasp has of its own."""


def _differentiable(
    solve: Callable[[ProblemBatch], tuple[PassResult, ...]], constrained: tuple[bool, ...]
) -> Callable[[ProblemBatch], tuple[Solution, ...]]:
    flat = _batched(solve)
    outer = jax.custom_jvp(flat)

    @outer.defjvp
    def jvp(primals, tangents):
        (problem,), (moved,) = primals, tangents
        solutions = outer(problem)
        moves = [derivative.tangent(problem, moved, *one) for one in zip(solutions, constrained, strict=True)]
        return solutions, tuple(map(_tangent_solution, solutions, moves))

    return outer


def _batched(solve: Callable[[ProblemBatch], tuple[PassResult, ...]]) -> Callable[[ProblemBatch], tuple[Solution, ...]]:
    @custom_vmap
    def flat(problem: ProblemBatch) -> tuple[Solution, ...]:
        return tuple(Solution(**{name: getattr(answer, name) for name in SOLUTION}) for answer in solve(problem))

    @flat.def_vmap
    def rule(axis_size: int, in_batched, problem: ProblemBatch):
        (batched,) = in_batched
        merged, size = _merge(axis_size, batched, problem)
        split = jax.tree.map(lambda x: x.reshape(axis_size, size, *x.shape[1:]), flat(merged))
        return split, jax.tree.map(lambda _: True, split)

    return flat


def _merge(axis_size: int, batched: ProblemBatch, problem: ProblemBatch) -> tuple[ProblemBatch, int]:
    """The problem with its mapped axis merged into the batch, and the size that each mapped element had."""
    size = problem.wrench.shape[1 if batched.wrench else 0]
    contacts = [field.name for field in fields(ProblemBatch) if field.name not in PER_WRENCH]
    shared = not any(jax.tree.leaves([getattr(batched, name) for name in contacts])) and problem.points.shape[0] == 1

    def merge(array: Array, is_batched: bool) -> Array:
        own = array if is_batched else array[None]
        wide = jnp.broadcast_to(own, (axis_size, size, *own.shape[2:]))
        return wide.reshape(axis_size * size, *own.shape[2:])

    merged = jax.tree.map(merge, problem, batched)
    if shared:
        own = {name: getattr(problem, name) for name in contacts}
        merged = ProblemBatch(**own, **{name: getattr(merged, name) for name in PER_WRENCH})
    return merged, size


def _tangent_solution(solution: Solution, parts: derivative.Tangent) -> Solution:
    """A Solution's tangent, whose integer fields have the dtype that JAX gives to tangents of integers."""
    unmoved = jax.tree.map(zero_tangent, solution)
    leaves = [getattr(parts, name) if hasattr(parts, name) else getattr(unmoved, name) for name in SOLUTION]
    return jax.tree.unflatten(jax.tree.structure(solution), [leaf for leaf in leaves if leaf is not None])


def _single(solve: Callable[[ProblemBatch], PassResult], constrained: bool) -> FlatSolver:
    alone = _differentiable(lambda problem: (solve(problem),), (constrained,))
    return lambda problem: alone(problem)[0]


closed_form = _single(passes.solve_closed, constrained=False)
optimum = _single(passes.solve_optimum, constrained=True)
closed_form_and_optimum = _differentiable(passes.solve_both, (False, True))
"""Both by one solver, which does their common work once."""


@cache
def optimum_by(solver: Any) -> FlatSolver:
    """The optimum by an optimistix solver."""
    return _single(partial(by_optimistix.solve_optimum, solver), constrained=True)
