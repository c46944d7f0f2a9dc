"""The transforms around a flat batch solver: derivatives outside, then batching, then the solver itself.

``custom_jvp`` is outermost, so that every derivative comes from ``derivative.py`` and none from the loops
inside. ``custom_vmap`` flattens every mapped axis into the one batch that the solver gathers from; it sees
when only the wrenches are mapped, and then the grasp's own work is done once.
"""

from collections.abc import Callable
from dataclasses import fields
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap

from jaxgrasp import kernel
from jaxgrasp.model.solution import Solution
from jaxgrasp.numerics.no_derivative import nan_tangents_where, zero_tangent
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import by_optimistix, derivative, in_kernel, phases
from jaxgrasp.solver.in_kernel import Wanted
from jaxgrasp.solver.result import PhaseResult

FlatSolver = Callable[[ProblemBatch], Solution]
"""A differentiable solver of a flat batch."""
SOLUTION = tuple(field.name for field in fields(Solution))
"""The names of its fields."""
PER_WRENCH = ("wrench", "start")
"""What each of many wrenches that share a grasp has of its own."""


def _differentiable(solve: Callable[[ProblemBatch], Any], constrained: Any) -> Callable[[ProblemBatch], Any]:
    """Return a solver of Solutions with derivatives from a solver of PhaseResults.

    ``constrained`` says whether the cones are imposed: a bool for one result, a tuple of bools for a tuple of results.
    """
    flat = _batched(solve)
    outer = jax.custom_jvp(flat)

    @outer.defjvp
    def jvp(primals, tangents):
        (problem,), (moved,) = primals, tangents
        solutions = outer(problem)

        def tangent(constrained: bool, solution: Solution) -> Solution:
            parts = derivative.tangent(problem, moved, solution, constrained)
            return nan_tangents_where(parts.undefined, _tangent_solution(solution, parts), problem, moved)

        return solutions, jax.tree.map(tangent, constrained, solutions)

    return outer


def _batched(solve: Callable[[ProblemBatch], Any]) -> Callable[[ProblemBatch], Any]:
    @custom_vmap
    def flat(problem: ProblemBatch) -> Any:
        return jax.tree.map(as_solution, solve(problem), is_leaf=lambda x: isinstance(x, PhaseResult))

    @flat.def_vmap
    def rule(axis_size: int, in_batched, problem: ProblemBatch):
        (batched,) = in_batched
        merged, size = _merge(axis_size, batched, problem)
        split = jax.tree.map(lambda x: x.reshape(axis_size, size, *x.shape[1:]), flat(merged))
        return split, jax.tree.map(lambda _: True, split)

    return flat


def as_solution(result: PhaseResult) -> Solution:
    """Return the fields of a result that users see."""
    return Solution(**{name: getattr(result, name) for name in SOLUTION})


def _merge(axis_size: int, batched: ProblemBatch, problem: ProblemBatch) -> tuple[ProblemBatch, int]:
    """Merge the mapped axis of a problem into its batch; return also the batch size of each mapped element."""
    size = problem.wrench.shape[1 if batched.wrench else 0]
    contacts = [field.name for field in fields(ProblemBatch) if field.name not in PER_WRENCH]
    shared = not any(jax.tree.leaves([getattr(batched, name) for name in contacts])) and problem.points.shape[0] == 1

    def merge(array: Array, is_batched: bool) -> Array:
        entries = array if is_batched else array[None]
        wide = jnp.broadcast_to(entries, (axis_size, size, *entries.shape[2:]))
        return wide.reshape(axis_size * size, *entries.shape[2:])

    merged = jax.tree.map(merge, problem, batched)
    if shared:
        shared_fields = {name: getattr(problem, name) for name in contacts}
        merged = ProblemBatch(**shared_fields, **{name: getattr(merged, name) for name in PER_WRENCH})
    return merged, size


def _tangent_solution(solution: Solution, parts: derivative.Tangent) -> Solution:
    """Return a Solution's tangent, whose integer fields have the dtype that JAX gives to tangents of integers.

    A field that is zero for every answer, as a certificate is, has a tangent of zero.
    """

    def of(name: str, field: Array) -> Any:
        moving = getattr(parts, name, None)
        return zero_tangent(field) if moving is None else moving

    named = [(name, getattr(solution, name)) for name in SOLUTION]
    leaves = [of(name, field) for name, field in named if field is not None]
    return jax.tree.unflatten(jax.tree.structure(solution), leaves)


class _Pair(NamedTuple):
    """A differentiable solver by the phases in JAX, and the same by the kernel."""

    by_phases: FlatSolver
    by_kernel: FlatSolver

    def __call__(self) -> FlatSolver:
        """Return the one to be used, two different objects: programs are kept by their solver."""
        return self.by_kernel if kernel.is_used() else self.by_phases


def _pair(solve: Callable[[ProblemBatch], Any], wanted: Wanted, constrained: Any) -> _Pair:
    by_kernel = partial(in_kernel.solve_traced, wanted=wanted, phases=solve)
    return _Pair(_differentiable(solve, constrained), _differentiable(by_kernel, constrained))


closed_form = _pair(phases.solve_closed, Wanted(closed_form=True, optimum=False), False)
"""Call it for the flat solver of the closed form, by the kernel where that is used, and so for the next ones."""
optimum = _pair(phases.solve_optimum, Wanted(closed_form=False, optimum=True), True)
closed_form_and_optimum = _pair(phases.solve_both, Wanted(closed_form=True, optimum=True), (False, True))
"""Both by one solver, which does their common work once."""


@cache
def optimum_by(solver: Any) -> FlatSolver:
    """Return the flat solver of the optimum by an optimistix solver."""
    return _differentiable(partial(by_optimistix.solve_optimum, solver), True)
