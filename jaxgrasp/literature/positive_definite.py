"""Flows within the positive definite matrices of friction cones (see ``buss.py``), for one problem whose load is one.

The matrix of a contact is linear in g = (mu f_n, f_1, f_2), and positive definite exactly where the first exceeds the
length of the other two; determinants, inverses and their derivatives are written by g.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.literature.internal import Internal
from jaxgrasp.literature.scaled_batch import ScaledBatch

LONGEST, SHORTEST = 6, -30
"""Powers of two, in radii of Dikin's ellipsoid, between which lengths of steps are tried."""
BRISK = 0.9
"""Part of a step that would reach just about the boundary."""
ROOM = 0.05
"""How far inside the cones a start should be, the load being one; less is taken where there is no more."""
FLAT = 1e-9
"""Slope along internal forces, relative to that of the two terms, at which a flow ends."""
FAR = 1e6
"""Internal forces, the load being one, that multipliers must prove necessary before there count as none."""
RIDGE = 1e-13
"""What keeps a metric invertible where a coordinate does not count, relative to its largest entry."""


class Trade(NamedTuple):
    """Weights of tr(P) and of tr(P^-1)."""

    effort: Array
    margin: Array


class Start(NamedTuple):
    """What the search for a strictly feasible start came to."""

    internal: Array
    found: Array
    hopeless: Array
    steps: Array


class End(NamedTuple):
    """What a flow came to."""

    internal: Array
    value: Array
    converged: Array
    steps: Array


class _CentringState(NamedTuple):
    internal: Array
    shift: Array
    hopeless: Array
    stuck: Array
    steps: Array


def own_axes(problem: ScaledBatch) -> Array:
    """From all forces ``(3n,)`` to g of all contacts, as one matrix ``(3n, 3n)``; zero for absent contacts."""
    n = len(problem.friction)
    farthest = jnp.eye(3)[jnp.argmin(jnp.abs(problem.normals), -1)]
    first = jnp.cross(problem.normals, farthest)
    size = jnp.linalg.norm(first, axis=-1, keepdims=True)
    first = first / jnp.where(size > 0, size, 1)
    rows = jnp.stack([problem.friction[:, None] * problem.normals, first, jnp.cross(problem.normals, first)], 1)
    return jnp.zeros((n, 3, n, 3)).at[jnp.arange(n), :, jnp.arange(n)].set(rows).reshape(3 * n, 3 * n)


def first_inside(problem: ScaledBatch, parts: Internal, axes: Array, max_steps: int) -> Start:
    """Lower s in P + s I > 0 by Dikin steps, until P itself is positive definite with some room."""
    still, inward = axes @ parts.particular, jnp.zeros_like(axes[0]).at[::3].set(problem.present.repeat(3)[::3])
    to_own = jnp.column_stack([axes @ parts.projection, inward])
    lack = jnp.max(jnp.linalg.norm(_each(still)[:, 1:], axis=-1) - still[::3], initial=0.0)
    downhill = jnp.zeros(len(still) + 1).at[-1].set(1.0)
    zero = jnp.zeros((), int)
    start = _CentringState(
        jnp.zeros_like(still), jnp.where(lack > -ROOM, 1.5 * lack + 0.5, -ROOM), zero > 0, zero > 0, zero
    )

    def going(state: _CentringState) -> Array:
        return (state.shift > -ROOM) & ~state.hopeless & ~state.stuck & (state.steps < max_steps)

    def step(state: _CentringState) -> _CentringState:
        own = still + to_own @ jnp.append(state.internal, state.shift)
        curved = _blocks(jax.vmap(jax.hessian(_barrier))(_safe(own, problem)))
        way, radius = _steepest(to_own.T @ curved @ to_own, parts, downhill)
        moves = radius * _lengths() * way
        fine = jax.vmap(
            lambda move: _is_inside(still + to_own @ (jnp.append(state.internal, state.shift) + move), problem)
        )
        share = BRISK * jnp.where(fine(moves).any(), moves[jnp.argmax(fine(moves))], 0)
        multipliers = -curved @ to_own @ way
        return _CentringState(
            internal=state.internal + share[:-1],
            shift=state.shift + share[-1],
            hopeless=_is_hopeless(still, multipliers, problem),
            stuck=-share[-1] <= 1e-14 * jnp.abs(state.shift),
            steps=state.steps + 1,
        )

    end = jax.lax.while_loop(going, step, start)
    found = (end.shift < 0) & _is_inside(still + to_own[:, :-1] @ end.internal, problem)
    return Start(end.internal, found, end.hopeless, end.steps)


def _is_hopeless(still: Array, multipliers: Array, problem: ScaledBatch) -> Array:
    """Whether multipliers q of the cones prove that s stays above zero: q.g >= 0 asks for s >= -q.g(particular)."""
    q = _each(multipliers)
    outside = jnp.max(jnp.where(problem.present > 0.5, jnp.linalg.norm(q[:, 1:], axis=-1) - q[:, 0], 0), initial=0.0)
    bound = -(multipliers @ still)
    return (bound > 1e-9) & (bound > FAR * outside)


def descend(
    problem: ScaledBatch,
    parts: Internal,
    axes: Array,
    trade: Trade,
    start: Array,
    inside: Array,
    plain: bool,
    max_steps: int,
) -> End:
    """Follow the gradient of the trade, measured by P^-1, or plainly by the matrices' own inner product."""
    still, to_own = axes @ parts.particular, axes @ parts.projection
    there = problem.present > 0.5

    def value(internal: Array) -> Array:
        own = still + to_own @ internal
        each = jax.vmap(_index, (0, None))(_safe(own, problem), trade)
        return jnp.where(_is_inside(own, problem), jnp.sum(jnp.where(there, each, 0)), jnp.inf)

    def slope_of(internal: Array) -> tuple[Array, Array]:
        own = _safe(still + to_own @ internal, problem)
        terms = [jax.vmap(jax.grad(_index), (0, None))(own, part) for part in _apart(trade)]
        effort, margin = (jnp.where(there[:, None], term, 0).ravel() for term in terms)
        size = jnp.linalg.norm(to_own.T @ effort) + jnp.linalg.norm(to_own.T @ margin)
        slope = to_own.T @ (effort + margin)
        return slope, jnp.linalg.norm(slope) <= FLAT * size

    def going(state: End) -> Array:
        return inside & ~state.converged & (state.steps < max_steps)

    def step(state: End) -> End:
        slope, _ = slope_of(state.internal)
        own = _safe(still + to_own @ state.internal, problem)
        curved = jnp.tile(jnp.diag(jnp.array([3.0, 2.0, 2.0])), (len(own), 1, 1)) if plain else _curved(own)
        way, radius = _steepest(to_own.T @ _blocks(curved) @ to_own, parts, slope)
        moves = radius * _lengths() * way
        values = jax.vmap(value)(state.internal + moves)
        best = jnp.argmin(values)
        better = values[best] < state.value
        internal = jnp.where(better, state.internal + moves[best], state.internal)
        # Where rounding hides any gain, the slope alone decides.
        flat = slope_of(internal)[1] | ~better
        return End(internal, jnp.where(better, values[best], state.value), flat, state.steps + 1)

    return jax.lax.while_loop(going, step, End(start, value(start), slope_of(start)[1], jnp.zeros((), int)))


def _curved(own: Array) -> Array:
    return jax.vmap(jax.hessian(_barrier))(own)


def _steepest(metric: Array, parts: Internal, slope: Array) -> tuple[Array, Array]:
    """The way of steepest descent by a metric over internal forces, and the step of length one."""
    n = len(parts.particular)
    idle = jnp.zeros_like(metric).at[:n, :n].set(jnp.eye(n) - parts.projection)
    largest = jnp.max(jnp.diag(metric))
    solid = metric + largest * (idle + RIDGE * jnp.eye(len(metric)))
    way = -jnp.linalg.solve(solid, slope)
    length = jnp.sqrt(jnp.maximum(way @ metric @ way, 0))
    return way, jnp.where(length > 0, 1 / jnp.where(length > 0, length, 1), 0)


def _apart(trade: Trade) -> tuple[Trade, Trade]:
    return trade._replace(margin=0 * trade.margin), trade._replace(effort=0 * trade.effort)


def _index(g: Array, trade: Trade) -> Array:
    """Weighted tr(P) + tr(P^-1) of one contact, whose eigenvalues are m and m plus or minus |t|."""
    m, square = g[0], g[1] ** 2 + g[2] ** 2
    return trade.effort * 3 * m + trade.margin * (1 / m + 2 * m / (m**2 - square))


def _barrier(g: Array) -> Array:
    """-log det P of one contact: its second derivative is Dikin's metric."""
    return -jnp.log(g[0]) - jnp.log(g[0] ** 2 - g[1] ** 2 - g[2] ** 2)


def _is_inside(own: Array, problem: ScaledBatch) -> Array:
    g = _each(own)
    return jnp.all((jnp.linalg.norm(g[:, 1:], axis=-1) < g[:, 0]) | (problem.present < 0.5))


def _safe(own: Array, problem: ScaledBatch) -> Array:
    """g of each contact ``(n, 3)``, with the identity where P is not positive definite or the contact is absent."""
    g = _each(own)
    fine = (jnp.linalg.norm(g[:, 1:], axis=-1) < g[:, 0]) & (problem.present > 0.5)
    return jnp.where(fine[:, None], g, jnp.array([1.0, 0.0, 0.0]))


def _each(own: Array) -> Array:
    return own.reshape(-1, 3)


def _blocks(blocks: Array) -> Array:
    """``(n, 3, 3)`` along the diagonal of a matrix ``(3n, 3n)``."""
    n = len(blocks)
    return jnp.zeros((n, 3, n, 3)).at[jnp.arange(n), :, jnp.arange(n)].set(blocks).reshape(3 * n, 3 * n)


def _lengths() -> Array:
    return 2.0 ** jnp.arange(LONGEST, SHORTEST - 1, -1)[:, None]
