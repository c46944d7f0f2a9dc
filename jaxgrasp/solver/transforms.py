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
from jaxgrasp.numerics.kept_programs import key_of
from jaxgrasp.numerics.no_derivative import nan_tangents_where, zero_tangent
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import by_optimistix, derivative, derivative_primitives, in_kernel, phases
from jaxgrasp.solver.in_kernel import Wanted
from jaxgrasp.solver.result import PhaseResult

FlatSolver = Callable[[ProblemBatch], Solution]
"""A differentiable solver of a flat batch."""
SOLUTION = tuple(field.name for field in fields(Solution))
"""The names of its fields."""
PER_WRENCH = ("wrench", "start")
"""What each of many wrenches that share a grasp has of its own."""


class DifferentiableSolver:
    """A flat solver of Solutions, with derivatives, from one of PhaseResults.

    Instances are compared by identity, as functions are.
    """

    def __init__(
        self,
        solve: Callable[[ProblemBatch], Any],
        constrained: Any,
        stages: phases.Stages | None = None,
        function_key: str | None = None,
        tangent: Callable[..., derivative.Tangent] = derivative_primitives.tangent,
        *,
        is_by_kernel: bool = False,
    ):
        """``constrained`` says whether the cones are imposed: a bool for one result, a tuple of bools for several.

        ``stages`` solve the same, where a plain call compiles them one by one; the last result is theirs.
        ``function_key`` says what is solved to the next process, which then finds its programs. ``tangent`` is the
        derivative, ``derivative.tangent`` or a function that returns the same. ``is_by_kernel`` is True where ``solve``
        compiles in no time, since the kernel is compiled already.
        """
        self.is_by_kernel = is_by_kernel
        self.stages = stages
        self.function_key = function_key
        self._tangent_of = tangent
        self._constrained = constrained
        self._solve = jax.custom_jvp(_batched(solve))
        self._solve.defjvp(self._jvp)
        self._constant = jax.custom_jvp(lambda problem, solutions: solutions)
        self._constant.defjvp(self._jvp_of_constant)

    def __call__(self, problem: ProblemBatch) -> Any:
        return self._solve(problem)

    def _jvp(self, primals: tuple[ProblemBatch], tangents: tuple[ProblemBatch]) -> tuple[Any, Any]:
        (problem,), (moved,) = primals, tangents
        solutions = self._solve(problem)
        return solutions, self._tangent(problem, moved, solutions)

    def with_derivative(self, problem: ProblemBatch, solutions: Any) -> Any:
        """Return the known ``solutions``, with the derivatives that solving ``problem`` has."""
        return self._constant(problem, solutions)

    def _jvp_of_constant(self, primals: tuple[ProblemBatch, Any], tangents: tuple[ProblemBatch, Any]) -> Any:
        (problem, _), (moved, _) = primals, tangents
        # Not the solutions themselves, which would be constants in derivatives of second order.
        solutions = self._constant(*primals)
        return solutions, self._tangent(problem, moved, solutions)

    def _tangent(self, problem: ProblemBatch, moved: ProblemBatch, solutions: Any) -> Any:
        """Return the tangents of the solutions of ``problem`` where it moves by ``moved``."""

        def of_one(constrained: bool, solution: Solution) -> Solution:
            parts = self._tangent_of(problem, moved, solution, constrained)
            return nan_tangents_where(parts.undefined, _tangent_solution(solution, parts), problem, moved)

        return jax.tree.map(of_one, self._constrained, solutions)

    @staticmethod
    def answer(first: tuple[PhaseResult, ...], last: PhaseResult) -> Any:
        """Return the Solutions of what the stages leave."""
        solutions = (*map(as_solution, first), as_solution(last))
        return solutions if first else solutions[0]


def _batched(solve: Callable[[ProblemBatch], Any]) -> Callable[[ProblemBatch], Any]:
    @custom_vmap
    def flat(problem: ProblemBatch) -> Any:
        return jax.tree.map(as_solution, solve(problem), is_leaf=lambda x: isinstance(x, PhaseResult))

    @flat.def_vmap
    def rule(axis_size: int, in_batched, problem: ProblemBatch):
        (batched,) = in_batched
        merged, size = merge_mapped_axis(axis_size, batched, problem)
        split = jax.tree.map(lambda x: x.reshape(axis_size, size, *x.shape[1:]), flat(merged))
        return split, jax.tree.map(lambda _: True, split)

    return flat


def as_solution(result: PhaseResult) -> Solution:
    """Return the fields of a result that users see."""
    return Solution(**{name: getattr(result, name) for name in SOLUTION})


def merge_mapped_axis(axis_size: int, batched: ProblemBatch, problem: ProblemBatch) -> tuple[ProblemBatch, int]:
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


class SolverPair(NamedTuple):
    """A differentiable solver by the phases in JAX, and the same by the kernel."""

    by_phases: DifferentiableSolver
    by_kernel: DifferentiableSolver

    def __call__(self, *unsupported: Any) -> DifferentiableSolver:
        """Return the one to be used; arguments other than None are what the kernel does not know.

        They are two different objects, since programs are kept by their solver.
        """
        uses_kernel = kernel.is_used() and all(argument is None for argument in unsupported)
        return self.by_kernel if uses_kernel else self.by_phases


def _pair(
    solve: Callable[[ProblemBatch], Any], wanted: Wanted, constrained: Any, stages: phases.Stages | None = None
) -> SolverPair:
    by_kernel = partial(in_kernel.solve_traced, wanted=wanted, phases=solve)
    key = key_of(solve)
    by_phases = DifferentiableSolver(solve, constrained, stages, None if key is None else f"Solution of {key}")
    tangent = partial(derivative_primitives.tangent, is_by_kernel=True)
    return SolverPair(by_phases, DifferentiableSolver(by_kernel, constrained, tangent=tangent, is_by_kernel=True))


closed_form = _pair(phases.solve_closed, Wanted(closed_form=True, optimum=False), False)
optimum = _pair(phases.solve_optimum, Wanted(closed_form=False, optimum=True), True, phases.OPTIMUM_STAGES)
closed_form_and_optimum = _pair(
    phases.solve_both, Wanted(closed_form=True, optimum=True), (False, True), phases.BOTH_STAGES
)
"""Both by one solver, which does their common work once."""


@cache
def optimum_by(solver: Any) -> FlatSolver:
    """Return the flat solver of the optimum by an optimistix solver."""
    return DifferentiableSolver(partial(by_optimistix.solve_optimum, solver), True)
