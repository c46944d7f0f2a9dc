"""How far a wrench can grow along a direction before friction and a hand's limits leave no forces that exert it.

One cone program for each problem, in units of what the hand can exert:

    minimise  P t - theta   over forces f in cones and limits,   theta = d.(G f - w),   t = |w + theta d - G f|.

What is missed of the wrench across the direction, t, costs more than any theta gains. So each program has an answer,
and t is zero wherever some wrench of the line is in reach. The multiplier of what is missed, and d, make a twist along
which d works at the rate 1; the limits' own multipliers pay for all that allowed forces can work along it, and so bound
theta.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram, Cones
from jaxgrasp.numerics.no_derivative import refusing, without_derivative
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem.batch_last import ProblemBatch, plain_batch_last
from jaxgrasp.problem.cone_problem import (
    ConeProblem,
    Units,
    absent,
    cone_problem,
    friction_cones,
    only,
    units_of,
)
from jaxgrasp.problem.inequalities import Inequalities, as_cones, limits_of, multipliers
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.problem.wrench_discs import scaled_wrench
from jaxgrasp.solver.multiplier_bounds import Prices, asked, constraints, leaning, push_of, spent

TILE = 32
EXTRA = 7
"""Unknowns beside the forces: what is missed, its size first."""
COST = 0.25
"""What a unit of missed wrench costs, as a power of the inverse rounding: beyond the rate at which a margin changes
with the load."""
ENDLESS = 1e3
"""Units that a contact presses with at the most where no limit is nearer; what rests on that is called endless."""
LOST = 0.4
"""What may be missed of a wrench that is in reach, and of the bound of its margin, or may rest on ``ENDLESS``: a power
of the rounding."""
TRUSTED = 1e-3
"""Largest gap, relative to what is missed and its cost, of a program that says that the line is out of reach."""


class LimitedMargin(NamedTuple):
    """How far a wrench can grow, and why no further."""

    margin: Array
    """``(B,)`` in units of the direction; +inf, -inf, or NaN where that was not found out."""
    theta: Array
    """``(B,)``: likewise in scaled units, a finite number always."""
    y: Array
    """``(B, n, c)``: the forces at the limit, in scaled units, and so for the next."""
    prices: Prices
    sound: Array
    """``(B,)``: whether the data can be used."""


@jax.custom_jvp
def limited_margin(problem: ProblemBatch, direction: Array) -> Array:
    """The margins of a flat batch ``(B,)`` along directions ``(B, 6)``."""
    return _limit(problem, direction).margin


@limited_margin.defjvp
def _moved(primals, tangents):
    """The envelope theorem: the Lagrangian is stationary in forces and multipliers at the limit."""
    found = _limit(*primals)
    finite = jnp.isfinite(found.margin)
    problem, direction = lax.stop_gradient(primals)
    own, aim = _own(problem, direction, found.sound)
    units, size = _units(own, aim)
    y = leaning(own, units, found.y, found.prices)

    def lagrangian(problem: ProblemBatch, direction: Array) -> Array:
        own, direction = _own(problem, direction, found.sound)
        posed, aim = _posed(own, direction, units, size)
        along = found.theta * (1 - jnp.sum(found.prices.twist * aim, -1))
        return units.load / size * (along - constraints(posed, found.prices, y))

    _, moved = jax.jvp(lagrangian, primals, tangents)
    unknown = ~finite & ~jnp.isposinf(found.margin)
    return found.margin, without_derivative(unknown, jnp.where(finite, moved, 0), primals, tangents)


@jax.custom_jvp
def _limit(problem: ProblemBatch, direction: Array) -> LimitedMargin:
    return over_tiles(_limit_of_tile, (problem, direction), problem.size, TILE, problem.count)


_limit.defjvp(refusing("wrench_margin has first derivatives only"))


def _is_sound(problem: ProblemBatch, direction: Array) -> Array:
    """Which problems hold data that can be used ``(B,)``."""
    _, valid = plain_batch_last(problem)
    largest = tolerances(direction.dtype).largest
    sound = valid[0] & (jnp.sum(jnp.abs(direction), -1) <= largest)
    bounds = problem.torque_bounds
    if bounds is not None:
        arms = jnp.sum(jnp.abs(bounds.map), (2, 3)) <= largest
        sound = sound & jnp.all(arms | ~_can_move(problem), -1) & jnp.all(bounds.most >= 0, -1)
    return sound


def _can_move(problem: ProblemBatch) -> Array:
    """Which contacts are there and carry anything."""
    return (problem.weights > 0) & (True if problem.present is None else problem.present > 0.5)


def _own(problem: ProblemBatch, direction: Array, sound: Array) -> tuple[ProblemBatch, Array]:
    """Each sound problem with a grasp of its own, of the contacts that can move, and its direction; else nothing."""
    there = _can_move(problem).astype(direction.dtype)
    whole = eqx.tree_at(lambda p: (p.present, p.count), problem, (there, None), is_leaf=lambda x: x is None)
    own = jax.tree.map(lambda x: jnp.broadcast_to(x, (problem.size, *x.shape[1:])), whole)
    return only(own, sound), jnp.where(sound[:, None], direction, 0)


def _units(problem: ProblemBatch, direction: Array) -> tuple[Units, Array]:
    """Forces in units of what the contacts can press with, or of the load, if that is more; the direction's length."""
    units = units_of(problem)
    posed = cone_problem(problem, units)
    most = jnp.full_like(posed.friction, jnp.inf) if posed.most is None else posed.most
    if posed.rows is not None and posed.torque_max is not None:
        each = jnp.abs(posed.rows[..., 0])
        least = jnp.where(each > 0, posed.torque_max[..., None] / jnp.where(each > 0, each, 1), jnp.inf)
        most = jnp.minimum(most, jnp.min(least, 1))
    counts = posed.there & jnp.isfinite(most) & (most > 0)
    # The geometric mean: neither a limit that is as good as none nor a contact that can do next to nothing rules it.
    mean = jnp.sum(jnp.where(counts, jnp.log(jnp.where(counts, most, 1)), 0), -1) / jnp.maximum(jnp.sum(counts, -1), 1)
    loaded = jnp.sum(jnp.abs(posed.right), -1) > 0
    load = units.load * jnp.where(loaded, jnp.maximum(jnp.exp(mean), 1), jnp.exp(mean))
    length = jnp.sqrt(jnp.sum(scaled_wrench(direction, units.about, units.length, jnp) ** 2, -1))
    return units._replace(load=load), jnp.where(length > 0, length, 1)


def _posed(problem: ProblemBatch, direction: Array, units: Units, size: Array) -> tuple[ConeProblem, Array]:
    """The problem, whose presses are all bounded, and the direction of length 1."""
    posed = cone_problem(problem, units)
    most = jnp.full_like(posed.friction, ENDLESS) if posed.most is None else jnp.minimum(posed.most, ENDLESS)
    aim = scaled_wrench(direction, units.about, units.length, jnp) / size[:, None]
    return posed._replace(most=jnp.where(posed.there, most, jnp.inf)), aim


def _limit_of_tile(given: tuple[ProblemBatch, Array]) -> LimitedMargin:
    sound = _is_sound(*given)
    problem, direction = _own(*given, sound)
    units, size = _units(problem, direction)
    posed, aim = _posed(problem, direction, units, size)
    inequalities, axes = _inequalities(posed), _axes(aim)
    rounding = float(jnp.finfo(aim.dtype).eps)
    cost = rounding**-COST
    best = cone_program.solve(_program(posed, aim, axes, inequalities, cost))
    batch, _, n, c = posed.columns.shape
    y = jnp.where(posed.there[..., None], best.point[:, :-EXTRA].reshape(batch, n, c), 0)
    twist = aim - jnp.einsum("bij,bi->bj", axes, _across(aim) * best.equality, precision=lax.Precision.HIGHEST)
    prices = Prices(twist, multipliers(inequalities, best.duals[-1]))
    beyond = jnp.einsum("bxnc,bnc->bx", posed.columns, y, precision=lax.Precision.HIGHEST) - posed.right
    theta = jnp.sum(aim * beyond, -1)
    small = rounding**LOST
    left = jnp.sqrt(jnp.sum((beyond - theta[:, None] * aim) ** 2, -1))
    reached = jnp.maximum(left, best.missed) <= small * (1 + jnp.abs(theta))
    close = jnp.abs(_bound(posed, aim, prices) - theta) <= small * (1 + jnp.abs(theta))
    out = best.gap <= TRUSTED * cost * left
    margin = jnp.where(close, units.load / size * theta, jnp.nan)
    endless = (_leant_on(posed, problem, units, prices) > small * (1 + jnp.abs(theta))) | ~jnp.any(aim != 0, -1)
    margin = jnp.where(endless, jnp.inf, margin)
    margin = jnp.where(reached, margin, jnp.where(out, -jnp.inf, jnp.nan))
    return LimitedMargin(jnp.where(sound, margin, -jnp.inf), theta, y, prices, sound)


def _inequalities(posed: ConeProblem) -> Inequalities:
    """Limits; but for the least press of absent contacts, which are at its end and would say so twice."""
    found = limits_of(posed, EXTRA)
    if posed.least is not None:
        rows, ends = found["least"]
        found["least"] = rows, jnp.where(posed.there, ends, jnp.inf)
    return found


def _axes(aim: Array) -> Array:
    """Orthonormal rows ``(B, 6, 6)``, the direction first, by a Householder reflection; without one the identity."""
    leads = jnp.any(aim != 0, -1)[:, None]
    first = jnp.eye(6, dtype=aim.dtype)[0]
    # Away from the first axis, so that nothing cancels.
    sign = jnp.where(aim[:, :1] > 0, 1, -1)
    across = jnp.where(leads, aim + sign * first, first)
    scaled = across * (2 / jnp.sum(across**2, -1, keepdims=True))
    reflected = jnp.eye(6, dtype=aim.dtype) - scaled[..., None] * across[:, None]
    return reflected.at[:, 0].set(jnp.where(leads, aim, first))


def _program(posed: ConeProblem, aim: Array, axes: Array, inequalities: Inequalities, cost: float) -> ConeProgram:
    """In the forces, the size of what is missed across the direction, and what is missed.

    Theta itself is none of the unknowns: it is what the forces exert along the direction. Without any direction nothing
    is led back to it.
    """
    batch, _, n, c = posed.columns.shape
    columns = posed.columns.reshape(batch, 6, n * c)
    along = jnp.einsum("bx,bxk->bk", aim, columns, precision=lax.Precision.HIGHEST)
    linear = jnp.concatenate([-along, jnp.full_like(aim[:, :1], cost), jnp.zeros_like(aim)], -1)
    kept = _across(aim)[..., None] * axes
    turned = jnp.einsum("bij,bjk->bik", kept, columns, precision=lax.Precision.HIGHEST)
    every = jnp.broadcast_to(jnp.eye(7, dtype=aim.dtype), (batch, 7, 7))
    balance = jnp.concatenate([turned, every[:, 1:]], -1)
    right = jnp.einsum("bij,bj->bi", kept, posed.right, precision=lax.Precision.HIGHEST)
    missed = Cones(jnp.pad(-every, [(0, 0), (0, 0), (posed.width, 0)])[:, None], jnp.zeros_like(every[:, None, 0]))
    cones = (friction_cones(posed, EXTRA), missed, as_cones(inequalities))
    return ConeProgram(absent(posed, EXTRA), linear, balance, right, cones)


def _across(aim: Array) -> Array:
    """Which of the axes' components have to be those of the load ``(B, 6)``: all but that along the direction."""
    return jnp.ones_like(aim).at[:, 0].set(jnp.where(jnp.any(aim != 0, -1), 0, 1))


def _bound(posed: ConeProblem, aim: Array, prices: Prices) -> Array:
    """What theta no forces exceed whose presses are within their limits ``(B,)``."""
    assert posed.most is not None
    gained = jnp.maximum(push_of(posed, prices).most, 0) * jnp.where(posed.there, posed.most, 0)
    rate = jnp.sum(prices.twist * aim, -1)
    given = spent(posed, prices) - asked(posed, prices) + jnp.sum(gained, -1)
    return jnp.where(rate > 0.5, given / jnp.where(rate > 0.5, rate, 1), jnp.inf)


def _leant_on(posed: ConeProblem, problem: ProblemBatch, units: Units, prices: Prices) -> Array:
    """How much of theta's bound rests on no limit of the hand, but on how far it was looked ``(B,)``."""
    assert posed.most is not None
    rests = prices.bounds["most"] * jnp.where(posed.there, posed.most, 0)
    if problem.normal_max is not None:
        rests = jnp.where(problem.normal_max / units.load[:, None] > ENDLESS, rests, 0)
    return jnp.sum(rests, -1)
