"""Largest growth of a wrench along a direction for which forces within friction and a hand's limits exert it.

One cone program for each problem, in units of what the hand can exert:

    minimise  P t - r theta   over forces f in cones and limits,   theta = d.(G f - w),   t = |w + theta d - G f|.

The wrench missed across the direction, t, costs more than theta gains as a rule (r = 1). Then t is zero wherever some
wrench of the line is in reach. Where t is not, a second run with r = 0 tells: its least t is zero, or no theta is in
reach. The multiplier of what is missed, and d, make a twist along which d works at the rate 1; the limits' own
multipliers pay for all that allowed forces can work along it, and so bound theta.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram, Cones
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.no_derivative import nan_tangents_where, refusing
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem.batch_last import ProblemBatch, to_batch_last_unfused
from jaxgrasp.problem.cone_problem import (
    ConeProblem,
    Inequalities,
    Units,
    absent,
    as_cones,
    cone_problem,
    friction_cones,
    inequality_multipliers,
    limits_of,
    restrict_to,
    units_of,
)
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.problem.wrench_discs import scaled_wrench
from jaxgrasp.solver.multiplier_bounds import (
    Multipliers,
    constraints,
    contact_power,
    limit_work,
    required_work,
    with_marginal_friction,
)

TILE = 32
EXTRA = 7
"""Unknowns beside the forces: what is missed, its size first."""
COST = 0.25
"""Cost of a unit of missed wrench, as a power of the inverse rounding: beyond the rate at which a margin changes
with the load."""
NORMAL_FORCE_CAP = 1e3
"""Units that a contact presses with at the most where no limit is nearer; what rests on that is called endless."""
LOST_EXPONENT = 0.4
"""Tolerance of the missed wrench, of the margin's bound, and of the share that rests on ``NORMAL_FORCE_CAP``:
an exponent of the machine epsilon."""
TRUSTED = 1e-3
"""Largest gap, relative to the cost of the missed wrench, of a program that proves that no theta is in reach."""


class LimitedMargin(NamedTuple):
    """Largest growth of a wrench, with the forces and multipliers at the limit."""

    margin: Array
    """``(B,)`` in units of the direction; +inf, -inf, or NaN where that was not found out."""
    theta: Array
    """``(B,)``: likewise in scaled units, a finite number always."""
    y: Array
    """``(B, n, c)``: the forces at the limit, in scaled units, and so for the next."""
    multipliers: Multipliers
    sound: Array
    """``(B,)``: whether the data can be used."""


@jax.custom_jvp
def limited_margin(problem: ProblemBatch, direction: Array) -> Array:
    """Compute the margins of a flat batch ``(B,)`` along directions ``(B, 6)``."""
    return _limit(problem, direction).margin


@limited_margin.defjvp
def _limited_margin_tangent(primals, tangents):
    """Differentiate by the envelope theorem: the Lagrangian is stationary in forces and multipliers at the limit."""
    optimum = _limit(*primals)
    finite = jnp.isfinite(optimum.margin)
    problem, direction = lax.stop_gradient(primals)
    sound_problem, aim = _sound_inputs(problem, direction, optimum.sound)
    units, size = _units(sound_problem, aim)
    y = with_marginal_friction(sound_problem, units, optimum.y, optimum.multipliers)

    def lagrangian(problem: ProblemBatch, direction: Array) -> Array:
        sound_problem, direction = _sound_inputs(problem, direction, optimum.sound)
        conic, aim = _bounded_problem(sound_problem, direction, units, size)
        along = optimum.theta * (1 - jnp.sum(optimum.multipliers.twist * aim, -1))
        return units.force_unit / size * (along - constraints(conic, optimum.multipliers, y))

    _, moved = jax.jvp(lagrangian, primals, tangents)
    is_unknown = ~finite & ~jnp.isposinf(optimum.margin)
    return optimum.margin, nan_tangents_where(is_unknown, jnp.where(finite, moved, 0), primals, tangents)


@jax.custom_jvp
def _limit(problem: ProblemBatch, direction: Array) -> LimitedMargin:
    return over_tiles(_limit_of_tile, (problem, direction), problem.size, TILE, problem.count)


_limit.defjvp(refusing("wrench_margin has first derivatives only"))


def _is_sound(problem: ProblemBatch, direction: Array) -> Array:
    """Return the mask ``(B,)`` of problems whose data can be used."""
    _, valid = to_batch_last_unfused(problem)
    largest = tolerances(direction.dtype).largest
    sound = valid[0] & (jnp.sum(jnp.abs(direction), -1) <= largest)
    bounds = problem.torque_bounds
    if bounds is not None:
        arms = jnp.sum(jnp.abs(bounds.torque_map), (2, 3)) <= largest
        sound = sound & jnp.all(arms | ~_is_adjustable(problem), -1) & jnp.all(bounds.torque_max >= 0, -1)
    return sound


def _is_adjustable(problem: ProblemBatch) -> Array:
    """Return the mask ``(B, n)`` of contacts that are present and have a weight above zero."""
    return (problem.weights > 0) & (True if problem.present is None else problem.present > 0.5)


def _sound_inputs(problem: ProblemBatch, direction: Array, sound: Array) -> tuple[ProblemBatch, Array]:
    """Return each sound problem with its own grasp of adjustable contacts, and its direction; zeros for others."""
    adjustable = _is_adjustable(problem).astype(direction.dtype)
    with_mask = eqx.tree_at(lambda p: (p.present, p.count), problem, (adjustable, None), is_leaf=lambda x: x is None)
    broadcast = jax.tree.map(lambda x: jnp.broadcast_to(x, (problem.size, *x.shape[1:])), with_mask)
    return restrict_to(broadcast, sound), jnp.where(sound[:, None], direction, 0)


def _units(problem: ProblemBatch, direction: Array) -> tuple[Units, Array]:
    """Return units of force, the mean limit of the contacts or the load if larger, and the length of the direction."""
    units = units_of(problem)
    conic = cone_problem(problem, units)
    most = jnp.full_like(conic.friction, jnp.inf) if conic.normal_max is None else conic.normal_max
    if conic.rows is not None and conic.torque_max is not None:
        coefficients = jnp.abs(conic.rows[..., 0])
        least = jnp.where(
            coefficients > 0, conic.torque_max[..., None] / jnp.where(coefficients > 0, coefficients, 1), jnp.inf
        )
        most = jnp.minimum(most, jnp.min(least, 1))
    counts = conic.present & jnp.isfinite(most) & (most > 0)
    # The geometric mean: neither a limit that is as good as none nor a contact that can do next to nothing rules it.
    mean = jnp.sum(jnp.where(counts, jnp.log(jnp.where(counts, most, 1)), 0), -1) / jnp.maximum(jnp.sum(counts, -1), 1)
    loaded = jnp.sum(jnp.abs(conic.right), -1) > 0
    load = units.force_unit * jnp.where(loaded, jnp.maximum(jnp.exp(mean), 1), jnp.exp(mean))
    length = jnp.sqrt(jnp.sum(scaled_wrench(direction, units.about, units.length, jnp) ** 2, -1))
    return units._replace(force_unit=load), jnp.where(length > 0, length, 1)


def _bounded_problem(problem: ProblemBatch, direction: Array, units: Units, size: Array) -> tuple[ConeProblem, Array]:
    """Scale the problem, bound all its normal forces, and scale the direction to length 1."""
    conic = cone_problem(problem, units)
    most = (
        jnp.full_like(conic.friction, NORMAL_FORCE_CAP)
        if conic.normal_max is None
        else jnp.minimum(conic.normal_max, NORMAL_FORCE_CAP)
    )
    aim = scaled_wrench(direction, units.about, units.length, jnp) / size[:, None]
    return conic._replace(normal_max=jnp.where(conic.present, most, jnp.inf)), aim


class _Answer(NamedTuple):
    """Answer of the program of each problem ``(B,)``."""

    theta: Array
    y: Array
    multipliers: Multipliers
    reached: Array
    """True where the wrench across the direction is exerted."""
    is_tight: Array
    """True where the duality gap is small beside the cost of the missed wrench, which so cannot be zero."""


def _limit_of_tile(arguments: tuple[ProblemBatch, Array]) -> LimitedMargin:
    sound = _is_sound(*arguments)
    problem, direction = _sound_inputs(*arguments, sound)
    units, size = _units(problem, direction)
    conic, aim = _bounded_problem(problem, direction, units, size)
    inequalities, axes = _inequalities(conic), _axes(aim)
    rounding = float(jnp.finfo(aim.dtype).eps)
    cost, small = rounding**-COST, rounding**LOST_EXPONENT

    def solve(reward: Array) -> _Answer:
        """Minimise P t - reward theta."""
        best = cone_program.solve(_program(conic, aim, axes, inequalities, cost, reward))
        batch, _, n, c = conic.columns.shape
        y = jnp.where(conic.present[..., None], best.point[:, :-EXTRA].reshape(batch, n, c), 0)
        twist = aim - jnp.einsum("bij,bi->bj", axes, _across(aim) * best.equality, precision=lax.Precision.HIGHEST)
        multipliers = Multipliers(twist, inequality_multipliers(inequalities, best.duals[-1]))
        beyond = jnp.einsum("bxnc,bnc->bx", conic.columns, y, precision=lax.Precision.HIGHEST) - conic.right
        theta = jnp.sum(aim * beyond, -1)
        missed_wrench_size = jnp.sqrt(jnp.sum((beyond - theta[:, None] * aim) ** 2, -1))
        reached = jnp.maximum(missed_wrench_size, best.residual) <= small * (1 + jnp.abs(theta))
        return _Answer(theta, y, multipliers, reached, best.gap <= TRUSTED * cost * missed_wrench_size)

    def run(carry: tuple[Array, _Answer, Array]) -> tuple[Array, _Answer, Array]:
        runs, answer, _ = carry
        is_first = runs == 0
        result = solve(is_first.astype(aim.dtype))
        answer = jax.tree.map(partial(jnp.where, is_first), result, answer)
        return runs + 1, answer, ~result.reached & result.is_tight

    # Contacts near a line gain more along d than the cost P of what they miss across it: then t > 0 proves nothing.
    # The second run, without theta, does: no theta is in reach where its least t is above zero.
    shapes = jax.eval_shape(solve, jnp.ones((), aim.dtype))
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    start = varying_like((jnp.int32(0), blank, blank.reached), conic)
    is_running = lambda carry: (carry[0] == 0) | ((carry[0] == 1) & jnp.any(~carry[1].reached))  # noqa: E731
    _, best, out = lax.while_loop(is_running, run, start)
    theta, multipliers = best.theta, best.multipliers
    close = jnp.abs(_bound(conic, aim, multipliers) - theta) <= small * (1 + jnp.abs(theta))
    margin = jnp.where(close, units.force_unit / size * theta, jnp.nan)
    endless = (_cap_share(conic, problem, units, multipliers) > small * (1 + jnp.abs(theta))) | ~jnp.any(aim != 0, -1)
    margin = jnp.where(endless, jnp.inf, margin)
    margin = jnp.where(best.reached, margin, jnp.where(out, -jnp.inf, jnp.nan))
    return LimitedMargin(jnp.where(sound, margin, -jnp.inf), theta, best.y, multipliers, sound)


def _inequalities(conic: ConeProblem) -> Inequalities:
    """Collect the limits, without least normal forces of absent contacts, which would bind twice."""
    inequalities = limits_of(conic, EXTRA)
    if conic.normal_min is not None:
        rows, ends = inequalities["normal_min"]
        inequalities["normal_min"] = rows, jnp.where(conic.present, ends, jnp.inf)
    return inequalities


def _axes(aim: Array) -> Array:
    """Compute orthonormal rows ``(B, 6, 6)``, the direction first, by Householder reflection; the identity if zero."""
    has_direction = jnp.any(aim != 0, -1)[:, None]
    first = jnp.eye(6, dtype=aim.dtype)[0]
    # Away from the first axis, so that nothing cancels.
    sign = jnp.where(aim[:, :1] > 0, 1, -1)
    across = jnp.where(has_direction, aim + sign * first, first)
    scaled = across * (2 / jnp.sum(across**2, -1, keepdims=True))
    reflected = jnp.eye(6, dtype=aim.dtype) - scaled[..., None] * across[:, None]
    return reflected.at[:, 0].set(jnp.where(has_direction, aim, first))


def _program(
    conic: ConeProblem, aim: Array, axes: Array, inequalities: Inequalities, cost: float, reward: Array
) -> ConeProgram:
    """Build the program in the forces, the size of the wrench missed across the direction, and that wrench.

    Theta itself is none of the unknowns: it is what the forces exert along the direction. Without any direction nothing
    is led back to it.
    """
    batch, _, n, c = conic.columns.shape
    columns = conic.columns.reshape(batch, 6, n * c)
    along = jnp.einsum("bx,bxk->bk", aim, columns, precision=lax.Precision.HIGHEST)
    linear = jnp.concatenate([-reward * along, jnp.full_like(aim[:, :1], cost), jnp.zeros_like(aim)], -1)
    across_axes = _across(aim)[..., None] * axes
    turned = jnp.einsum("bij,bjk->bik", across_axes, columns, precision=lax.Precision.HIGHEST)
    identity = jnp.broadcast_to(jnp.eye(7, dtype=aim.dtype), (batch, 7, 7))
    balance = jnp.concatenate([turned, identity[:, 1:]], -1)
    right = jnp.einsum("bij,bj->bi", across_axes, conic.right, precision=lax.Precision.HIGHEST)
    residual = Cones(
        jnp.pad(-identity, [(0, 0), (0, 0), (conic.width, 0)])[:, None], jnp.zeros_like(identity[:, None, 0])
    )
    cones = (friction_cones(conic, EXTRA), residual, as_cones(inequalities))
    return ConeProgram(absent(conic, EXTRA), linear, balance, right, cones)


def _across(aim: Array) -> Array:
    """Return ones ``(B, 6)`` for the axes whose components must equal the load's: all but the direction's."""
    return jnp.ones_like(aim).at[:, 0].set(jnp.where(jnp.any(aim != 0, -1), 0, 1))


def _bound(conic: ConeProblem, aim: Array, multipliers: Multipliers) -> Array:
    """Compute the bound ``(B,)`` of theta that no forces exceed whose normal forces are within their limits."""
    assert conic.normal_max is not None
    gained = jnp.maximum(contact_power(conic, multipliers).per_normal_force, 0) * jnp.where(
        conic.present, conic.normal_max, 0
    )
    rate = jnp.sum(multipliers.twist * aim, -1)
    largest_work = limit_work(conic, multipliers) - required_work(conic, multipliers) + jnp.sum(gained, -1)
    return jnp.where(rate > 0.5, largest_work / jnp.where(rate > 0.5, rate, 1), jnp.inf)


def _cap_share(conic: ConeProblem, problem: ProblemBatch, units: Units, multipliers: Multipliers) -> Array:
    """Compute the part ``(B,)`` of theta's bound that rests on ``NORMAL_FORCE_CAP``, not on a limit of the hand."""
    assert conic.normal_max is not None
    cap_work = multipliers.bounds["normal_max"] * jnp.where(conic.present, conic.normal_max, 0)
    if problem.normal_max is not None:
        cap_work = jnp.where(problem.normal_max / units.force_unit[:, None] > NORMAL_FORCE_CAP, cap_work, 0)
    return jnp.sum(cap_work, -1)
