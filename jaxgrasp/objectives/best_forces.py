"""Contact forces by other objectives than closeness to the squeezing forces, with a bound on the optimum."""

from functools import partial
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.solution import Solution, Verdict, verdict_names
from jaxgrasp.numerics.no_derivative import nan_tangents_where, nondifferentiable_where, refusing, zero_tangent
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.objectives import largest_margin, least_maximal, least_torque
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.cone_problem import (
    ConeProblem,
    Units,
    cone_problem,
    forces_of_y,
    residual_norm,
    restrict_to,
    units_of,
    y_of_forces,
)
from jaxgrasp.problem.flatten import flatten
from jaxgrasp.solver import transforms
from jaxgrasp.solver.multiplier_bounds import SearchResult, with_marginal_friction
from jaxgrasp.validation.checked import checked

Objective = Literal["least_norm", "least_maximal_force", "largest_margin", "least_torque"]
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
"""Objectives of ``best_forces``."""
TILE = 32
OPTIMAL_GAP = 1e-4
"""Largest gap of value and bound, relative to the value, of an optimal result."""
ZERO_VALUE_EXPONENT = 0.45
"""Exponent of the machine epsilon: the largest gap of value and bound of an optimal result where the value is zero but
for rounding, in units of the load."""
LOST_EXPONENT = 0.4
"""Exponent of the machine epsilon: the largest residual of wrench and limits, in units of the load."""
METHODS: dict[str, Any] = {
    "least_maximal_force": least_maximal,
    "largest_margin": largest_margin,
    "least_torque": least_torque,
}


class BestForces(NamedTuple):
    """The best forces of an objective, with a bound on all others."""

    forces: Float[Array, "*batch n 3"]
    """Allowed forces that exert the wrench [N]; zero where none exist."""
    moments: Float[Array, "*batch n"] | None
    """Moments of soft fingers about their normals, with those forces [N.m]; None where all contacts are hard."""
    value: Float[Array, "*batch"]
    """Value of the objective for these forces, in its units; +inf where none exist, -inf for a margin."""
    bound: Float[Array, "*batch"]
    """Bound of the objective that no forces pass, proven by multipliers, apart from rounding."""
    verdict: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.Verdict`][]: OPTIMAL where value and bound agree as far as they can be told apart,
    NOT_CONVERGED where forces exist but the gap is larger, else that of the constrained optimum."""
    certificate: Float[Array, "*batch 6"]
    """Proof where the verdict is INFEASIBLE, for [`jaxgrasp.verify_certificate`][]."""
    certificate_rates: Float[Array, "*batch j"] | None
    """Joint velocities of the certificate; None where no torque is limited."""

    @property
    def verdict_name(self) -> Any:
        """Name of the verdict, such as ``"OPTIMAL"``; of a batch an array of names ``(*batch)``."""
        return verdict_names(self.verdict)


@checked
def best_forces(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    objective: Objective,
    *,
    limits: Limits | None = None,
) -> BestForces:
    """Compute forces inside the friction cones and limits that exert the wrench, optimal by an objective.

    The objectives, none of which depends on the squeezing forces:

    - ``"least_norm"``: the root of the sum of |f_i|^2 [N];
    - ``"least_maximal_force"``: the largest |f_i| [N];
    - ``"largest_margin"``: the smallest friction margin of a loaded contact, as [`jaxgrasp.friction_margin`][] has it
      [rad], without contacts that have no friction. Larger forces leave a larger margin, so ``limits.normal_max`` is
      required; no contact presses with more than a thousand times the load, whatever the limit;
    - ``"least_torque"``: the root of the sum of squares of the joint torques, ``limits.torque_map`` times the forces
      [N.m], within ``limits.torque_max`` where it is given. Of several forces of the least torques, small ones.

    A moment of a soft finger counts as the tangential force that uses as much friction. The margin is accurate to some
    1e-6, as value and bound show. Where limits lie within some 1e-8 of the feasible wrenches, or leave the forces no
    freedom, as with equal ``normal_min`` and ``normal_max``, the gap of value and bound grows. The bound of least
    torques is proven for normal forces up to ``normal_max``, or to a thousand times the sum of those returned where
    that is less.

    The ``value`` is differentiable once, by all arguments: its derivative is that of the Lagrangian at the forces and
    multipliers of the solution. Where these are not unique, it is the derivative for one pair; where the value is zero,
    its minimum, the derivative is zero. It is NaN where no forces exist, for the largest margin by a friction of zero,
    and for the other fields except for the least norm, whose forces are those of [`jaxgrasp.constrained_optimum`][].

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        objective: one of [`jaxgrasp.OBJECTIVES`][].
        limits: as for [`jaxgrasp.constrained_optimum`][].

    Raises:
        ValueError: for an unknown objective, a limit that is missing, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    _check(objective, limits)
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {})
    # Each part is compiled separately, so that the objectives, and their derivatives, share the solver.
    problem, batch = _flat(grasp, wrench, _bounded(limits) if objective == "least_torque" else limits)
    if objective == "least_norm":
        result = _least_norm(_solved(problem))
    else:
        result = _best(problem, _solved(jax.lax.stop_gradient(problem)), objective)
    return jax.tree.map(lambda x: x.reshape(batch + x.shape[1:]), result)


def _check(objective: str, limits: Limits | None) -> None:
    if objective == "least_torque" and (limits is None or limits.torque_map is None):
        raise ValueError("torque_map is None: least_torque needs limits with a torque_map")
    if objective == "largest_margin" and (limits is None or limits.normal_max is None):
        raise ValueError("normal_max is None: largest_margin needs limits with a normal_max")


def _bounded(limits: Limits | None) -> Limits | None:
    """Add an infinite bound of every torque where none is given."""
    if limits is None or limits.torque_map is None or limits.torque_max is not None:
        return limits
    unlimited = jnp.full(jnp.shape(limits.torque_map)[-1:], jnp.inf)
    return eqx.tree_at(lambda x: x.torque_max, limits, unlimited, is_leaf=lambda x: x is None)


def _flat(grasp: Grasp, wrench: AnyArray, limits: Limits | None) -> tuple[ProblemBatch, tuple[int, ...]]:
    """Flatten to problems without squeezing forces; a grasp that all wrenches share is repeated for each."""
    unsqueezed = eqx.tree_at(lambda g: g.squeeze, grasp, jnp.zeros_like(jnp.asarray(grasp.squeeze)))
    problem, _, batch = flatten(unsqueezed, wrench, None, "uniform", limits=limits)
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (problem.size, *x.shape[1:])), problem), batch


@jax.jit
def _solved(problem: ProblemBatch) -> Solution:
    return transforms.optimum()(problem)


@jax.jit
def _least_norm(solution: Solution) -> BestForces:
    solved = solution.verdict <= Verdict.OPTIMAL
    # value = sqrt(2 objective); its derivative is zero where it is zero.
    is_positive = solved & (solution.objective > 0)
    size = jnp.where(is_positive, jnp.sqrt(2 * jnp.where(is_positive, solution.objective, 1)), 0)
    value = nondifferentiable_where(~solved, jnp.where(solved, size, jnp.inf), solution.objective)
    return _answer(solution, solved, solution.forces, solution.moments, value, value)


def _answer(
    solution: Solution, solved: Array, forces: Array, moments: Array | None, value: Array, bound: Array
) -> BestForces:
    verdict = jnp.where(solution.verdict == Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, solution.verdict)
    return BestForces(
        forces=nondifferentiable_where(~solved, jnp.where(solved[:, None, None], forces, 0), forces),
        moments=None
        if moments is None
        else nondifferentiable_where(~solved, jnp.where(solved[:, None], moments, 0), moments),
        value=value,
        bound=bound,
        verdict=verdict,
        certificate=solution.certificate,
        certificate_rates=solution.certificate_rates,
    )


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _best(problem: ProblemBatch, solution: Solution, objective: Objective) -> BestForces:
    return _search(problem, solution, objective)[0]


@_best.defjvp
def _best_jvp(objective, primals, tangents):
    """Differentiate by the envelope theorem: the Lagrangian is stationary in forces and multipliers at the optimum."""
    best, result = _search(*primals, objective)
    problem, tangent = primals[0], tangents[0]
    solved = jnp.isfinite(best.value)
    value = nan_tangents_where(~solved, _value_tangent(problem, tangent, result, solved, objective), problem, tangent)
    if objective == "largest_margin":
        # The margin of a contact without friction starts to count with its first friction: no derivative there.
        no_friction = solved[:, None] & (problem.friction == 0)
        if problem.present is not None:
            no_friction = no_friction & (problem.present > 0.5)
        slick_friction, friction_tangent = (jnp.where(no_friction, of.friction, 0) for of in (problem, tangent))
        value = nan_tangents_where(jnp.any(no_friction, 1), value, slick_friction, friction_tangent)
    nan_tangents = nan_tangents_where(jnp.ones_like(solved), jax.tree.map(zero_tangent, best), problem, tangent)
    return best, nan_tangents._replace(value=value)


@partial(jax.jit, static_argnames=("objective",))
def _value_tangent(
    problem: ProblemBatch, tangent: ProblemBatch, result: SearchResult, solved: Array, objective: Objective
) -> Array:
    """Compute the tangent of the value."""
    units = units_of(restrict_to(problem, solved))
    if objective != "largest_margin":
        result = result._replace(
            y=with_marginal_friction(restrict_to(problem, solved), units, result.y, result.multipliers)
        )

    def lagrangian(problem: ProblemBatch) -> Array:
        conic = cone_problem(restrict_to(problem, solved), units)
        return _scale(units, objective) * METHODS[objective].lagrangian(conic, result)

    return jnp.where(solved, jax.jvp(lagrangian, (problem,), (tangent,))[1], 0)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _search(problem: ProblemBatch, solution: Solution, objective: Objective) -> tuple[BestForces, SearchResult]:
    return _searched(problem, solution, objective)


_search.defjvp(refusing("best_forces has first derivatives only"))


@partial(jax.jit, static_argnames=("objective",))
def _searched(problem: ProblemBatch, solution: Solution, objective: Objective) -> tuple[BestForces, SearchResult]:
    solved = solution.verdict <= Verdict.OPTIMAL
    tile = partial(_tile, objective=objective)
    forces, moments, value, bound, close, result = over_tiles(tile, (problem, solution), problem.size, TILE)
    no_value = -jnp.inf if objective == "largest_margin" else jnp.inf
    value, bound = (jnp.where(solved, x, no_value) for x in (value, bound))
    best = _answer(solution, solved, forces, moments, value, bound)
    claimed = jnp.where(close, Verdict.OPTIMAL, Verdict.NOT_CONVERGED).astype(best.verdict.dtype)
    return best._replace(verdict=jnp.where(solved, claimed, best.verdict)), result


def _tile(problem_and_solution: tuple[ProblemBatch, Solution], objective: Objective):
    problem, solution = problem_and_solution
    solved = solution.verdict <= Verdict.OPTIMAL
    problem = restrict_to(problem, solved)
    units = units_of(problem)
    conic = cone_problem(problem, units)
    method = METHODS[objective]
    result = method.search(conic)
    # A search that diverged is replaced by the forces of the constrained optimum.
    optimum_y = y_of_forces(conic, units, problem, solution.forces, solution.moments)
    lost = ~(
        jnp.maximum(residual_norm(conic, result.y), result.residual)
        <= float(jnp.finfo(optimum_y.dtype).eps) ** LOST_EXPONENT
    )
    y = jnp.where(lost[:, None, None], optimum_y, result.y)
    value = method.value(conic, y)
    bound = _safe_bound(conic, value, result.bound, objective)
    close = (
        jnp.abs(value - bound)
        <= OPTIMAL_GAP * jnp.abs(value) + float(jnp.finfo(value.dtype).eps) ** ZERO_VALUE_EXPONENT
    )
    forces, moments = forces_of_y(conic, units, problem, y)
    scale = _scale(units, objective)
    return forces, moments, scale * value, scale * bound, close & ~lost, result


def _safe_bound(conic: ConeProblem, value: Array, bound: Array, objective: Objective) -> Array:
    """Return the bound; where rounding lets the value pass it, a bound that needs no proof."""
    tiny = float(jnp.finfo(value.dtype).eps) ** ZERO_VALUE_EXPONENT
    if objective == "largest_margin":
        return jnp.where(bound >= value - tiny, jnp.maximum(bound, value), largest_margin.widest(conic))
    return jnp.where(bound <= value + OPTIMAL_GAP * value + tiny, jnp.minimum(bound, value), 0)


def _scale(units: Units, objective: Objective) -> Array:
    """Return the size of a unit of ``ConeProblem`` in the objective's units."""
    if objective == "largest_margin":
        return jnp.ones_like(units.force_unit)
    return units.force_unit * units.torque if objective == "least_torque" else units.force_unit
