"""Forces by another objective than closeness to the squeezing forces, with what bounds it."""

from functools import partial
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.model.solution import Solution, Verdict, verdict_names
from jaxgrasp.numerics.no_derivative import nan_tangents_where, nondifferentiable_where, refusing
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.numerics.zero_tangent import zero_tangent
from jaxgrasp.objectives import largest_margin, least_maximal, least_torque
from jaxgrasp.objectives.search import SearchResult
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.cone_problem import (
    ConeProblem,
    Units,
    cone_problem,
    forces_of_y,
    only,
    residual_norm,
    units_of,
    y_of_forces,
)
from jaxgrasp.problem.flatten import flatten
from jaxgrasp.solver import transforms
from jaxgrasp.solver.multiplier_bounds import with_marginal_friction
from jaxgrasp.validation.checked import checked

Objective = Literal["least_norm", "least_maximal_force", "largest_margin", "least_torque"]
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
"""What ``best_forces`` takes for an objective."""
TILE = 32
OPTIMAL_GAP = 1e-4
"""Largest distance of value and bound, relative to the value, that is called optimal."""
ZERO_VALUE_EXPONENT = 0.45
"""An exponent of the machine epsilon: the distance of value and bound that is called optimal where the value is zero
but for rounding, in units of the load."""
LOST_EXPONENT = 0.4
"""An exponent of the machine epsilon: by how much forces may miss their wrench or limits, in units of the load."""
METHODS: dict[str, Any] = {
    "least_maximal_force": least_maximal,
    "largest_margin": largest_margin,
    "least_torque": least_torque,
}


class BestForces(NamedTuple):
    """The best forces of an objective, and how good any others can be."""

    forces: Float[Array, "*batch n 3"]
    """Allowed forces that exert the wrench [N]; zero where there are none."""
    moments: Float[Array, "*batch n"] | None
    """Moments of soft fingers about their normals, with those forces [N.m]; None where all contacts are hard."""
    value: Float[Array, "*batch"]
    """What these forces achieve, in the objective's units; where there are none +inf, of a margin -inf."""
    bound: Float[Array, "*batch"]
    """What no others are better than: a proof by multipliers, apart from rounding."""
    verdict: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.Verdict`][]: OPTIMAL where value and bound are as close as they can be told apart,
    NOT_CONVERGED where forces exist and that was not reached, else that of the constrained optimum."""
    certificate: Float[Array, "*batch 6"]
    """Proof where the verdict is INFEASIBLE, for [`jaxgrasp.verify_certificate`][]."""
    certificate_rates: Float[Array, "*batch j"] | None
    """Speeds of the joints that belong to the certificate; None where no torque is limited."""

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
    """Forces inside the friction cones and limits that exert the wrench, best by an objective.

    The objectives, all of which leave the squeezing forces out of account:

    - ``"least_norm"``: the root of the sum of |f_i|^2 [N];
    - ``"least_maximal_force"``: the largest |f_i| [N];
    - ``"largest_margin"``: the smallest friction margin of a loaded contact, as [`jaxgrasp.friction_margin`][] has it
      [rad], contacts without friction left out of account. Larger forces leave more of it, so ``limits.normal_max`` has
      to be given; no contact presses with more than a thousand times the load, whatever it says;
    - ``"least_torque"``: the root of the sum of squares of the joint torques that ``limits.torque_map`` says forces
      ask for [N.m], ``limits.torque_max`` kept where it is given. Where several forces ask for the least, small ones.

    A moment of a soft finger counts as the tangential force that uses as much friction. The margin is found to some
    1e-6, as value and bound show.
    Where limits lie within some 1e-8 of what can be exerted at all, or leave forces no room as where ``normal_min`` is
    ``normal_max``, value and bound drift apart, as they show.
    The bound of least torques is proven for normal forces up to ``normal_max``, or to a thousand times the sum of those
    returned where that is less.

    The ``value`` is differentiable once, by everything: it moves as the Lagrangian does at the forces and multipliers
    found. Where there are several of these, the derivative is that of one pair; where nothing has to be spent the value
    is at its least, and zero is the derivative chosen. There is none (NaN) where there are no forces, nor, of the
    largest margin, by a friction of zero, nor of the other fields but for the least norm, whose forces are those of
    [`jaxgrasp.constrained_optimum`][].

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        objective: one of [`jaxgrasp.OBJECTIVES`][].
        limits: as for [`jaxgrasp.constrained_optimum`][].

    Raises:
        ValueError: for an unknown objective, a limit that it lacks, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    _check(objective, limits)
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {})
    # Each part is compiled by itself, so that the objectives, and their derivatives, share the solver.
    problem, batch = _flat(grasp, wrench, _bounded(limits) if objective == "least_torque" else limits)
    if objective == "least_norm":
        found = _least_norm(_solved(problem))
    else:
        found = _best(problem, _solved(jax.lax.stop_gradient(problem)), objective)
    return jax.tree.map(lambda x: x.reshape(batch + x.shape[1:]), found)


def _check(objective: str, limits: Limits | None) -> None:
    if objective == "least_torque" and (limits is None or limits.torque_map is None):
        raise ValueError("torque_map is None: expected limits with a torque_map, since least_torque is about torques")
    if objective == "largest_margin" and (limits is None or limits.normal_max is None):
        raise ValueError("normal_max is None: expected limits with a normal_max, since more force leaves more margin")


def _bounded(limits: Limits | None) -> Limits | None:
    """With a bound of every torque, if only an infinite one."""
    if limits is None or limits.torque_map is None or limits.torque_max is not None:
        return limits
    endless = jnp.full(jnp.shape(limits.torque_map)[-1:], jnp.inf)
    return eqx.tree_at(lambda x: x.torque_max, limits, endless, is_leaf=lambda x: x is None)


def _flat(grasp: Grasp, wrench: AnyArray, limits: Limits | None) -> tuple[ProblemBatch, tuple[int, ...]]:
    """Problems without squeezing forces, a grasp that all wrenches share repeated for each."""
    calm = eqx.tree_at(lambda g: g.squeeze, grasp, jnp.zeros_like(jnp.asarray(grasp.squeeze)))
    problem, _, batch = flatten(calm, wrench, None, "uniform", limits=limits)
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (problem.size, *x.shape[1:])), problem), batch


@jax.jit
def _solved(problem: ProblemBatch) -> Solution:
    return transforms.optimum(problem)


@jax.jit
def _least_norm(solution: Solution) -> BestForces:
    solved = solution.verdict <= Verdict.OPTIMAL
    # Half the sum of squares, of derivative zero where it is zero.
    some = solved & (solution.objective > 0)
    size = jnp.where(some, jnp.sqrt(2 * jnp.where(some, solution.objective, 1)), 0)
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
def _best_moves(objective, primals, tangents):
    """The envelope theorem: the Lagrangian is stationary in forces and multipliers at the optimum."""
    best, found = _search(*primals, objective)
    problem, moved = primals[0], tangents[0]
    solved = jnp.isfinite(best.value)
    value = nan_tangents_where(~solved, _moved(problem, moved, found, solved, objective), problem, moved)
    if objective == "largest_margin":
        # A contact has a margin to lose as soon as it has friction.
        slick = solved[:, None] & (problem.friction == 0)
        if problem.present is not None:
            slick = slick & (problem.present > 0.5)
        slick_friction, slick_moved = (jnp.where(slick, of.friction, 0) for of in (problem, moved))
        value = nan_tangents_where(jnp.any(slick, 1), value, slick_friction, slick_moved)
    none = nan_tangents_where(jnp.ones_like(solved), jax.tree.map(zero_tangent, best), problem, moved)
    return best, none._replace(value=value)


@partial(jax.jit, static_argnames=("objective",))
def _moved(
    problem: ProblemBatch, tangent: ProblemBatch, found: SearchResult, solved: Array, objective: Objective
) -> Array:
    """How the value moves with the problem."""
    units = units_of(only(problem, solved))
    if objective != "largest_margin":
        found = found._replace(y=with_marginal_friction(only(problem, solved), units, found.y, found.multipliers))

    def lagrangian(problem: ProblemBatch) -> Array:
        conic = cone_problem(only(problem, solved), units)
        return _scale(units, objective) * METHODS[objective].lagrangian(conic, found)

    return jnp.where(solved, jax.jvp(lagrangian, (problem,), (tangent,))[1], 0)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _search(problem: ProblemBatch, solution: Solution, objective: Objective) -> tuple[BestForces, SearchResult]:
    return _searched(problem, solution, objective)


_search.defjvp(refusing("best_forces has first derivatives only"))


@partial(jax.jit, static_argnames=("objective",))
def _searched(problem: ProblemBatch, solution: Solution, objective: Objective) -> tuple[BestForces, SearchResult]:
    solved = solution.verdict <= Verdict.OPTIMAL
    tile = partial(_tile, objective=objective)
    forces, moments, value, bound, close, found = over_tiles(tile, (problem, solution), problem.size, TILE)
    nothing = -jnp.inf if objective == "largest_margin" else jnp.inf
    value, bound = (jnp.where(solved, x, nothing) for x in (value, bound))
    best = _answer(solution, solved, forces, moments, value, bound)
    judged = jnp.where(close, Verdict.OPTIMAL, Verdict.NOT_CONVERGED).astype(best.verdict.dtype)
    return best._replace(verdict=jnp.where(solved, judged, best.verdict)), found


def _tile(given: tuple[ProblemBatch, Solution], objective: Objective):
    problem, solution = given
    solved = solution.verdict <= Verdict.OPTIMAL
    problem = only(problem, solved)
    units = units_of(problem)
    conic = cone_problem(problem, units)
    method = METHODS[objective]
    found = method.search(conic)
    # A search that got lost leaves the forces that are known.
    known = y_of_forces(conic, units, problem, solution.forces, solution.moments)
    lost = ~(
        jnp.maximum(residual_norm(conic, found.y), found.missed) <= float(jnp.finfo(known.dtype).eps) ** LOST_EXPONENT
    )
    y = jnp.where(lost[:, None, None], known, found.y)
    value = method.value(conic, y)
    bound = _believed(conic, value, found.bound, objective)
    close = (
        jnp.abs(value - bound)
        <= OPTIMAL_GAP * jnp.abs(value) + float(jnp.finfo(value.dtype).eps) ** ZERO_VALUE_EXPONENT
    )
    forces, moments = forces_of_y(conic, units, problem, y)
    scale = _scale(units, objective)
    return forces, moments, scale * value, scale * bound, close & ~lost, found


def _believed(conic: ConeProblem, value: Array, bound: Array, objective: Objective) -> Array:
    """The bound; of forces that rounding lets beat it, what needs no proof."""
    tiny = float(jnp.finfo(value.dtype).eps) ** ZERO_VALUE_EXPONENT
    if objective == "largest_margin":
        return jnp.where(bound >= value - tiny, jnp.maximum(bound, value), largest_margin.widest(conic))
    return jnp.where(bound <= value + OPTIMAL_GAP * value + tiny, jnp.minimum(bound, value), 0)


def _scale(units: Units, objective: Objective) -> Array:
    """The size of one unit of ``ConeProblem`` in the objective's units."""
    if objective == "largest_margin":
        return jnp.ones_like(units.force_unit)
    return units.force_unit * units.torque if objective == "least_torque" else units.force_unit
