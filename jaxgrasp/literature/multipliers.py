"""The method of multipliers for friction cones (see ``nakamura.py``), for one problem whose load is one.

Minimise |h|^2 / 2 over internal forces h such that every force of f = particular + h lies in its cone K. With
multipliers p in the dual cones, each round minimises |h|^2 / 2 + |q|^2 / (2 rho), q the projection of p - rho f on the
dual cones, by Newton's method, takes q for p, and raises rho.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.literature.batch_problem import ScaledBatch
from jaxgrasp.literature.internal import Internal
from jaxgrasp.numerics import vec3
from jaxgrasp.problem import friction_cone
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.friction_cone import Cone

RAISE, STIFFEST = 4.0, 1e6
"""Factor on rho after each round, from 1 on, and the largest rho: beyond it rounding spoils the Newton steps."""
CLOSE = 1e-11
"""Distance of forces from their cones, the load being one, at which a round is the last."""
FLAT = 1e-12
"""Slope, relative to the multipliers, at which Newton's method ends."""
NEWTON_STEPS, HALVINGS = 40, 30
FAR = 1e6
"""Internal forces, the load being one, that multipliers must prove necessary before there count as none."""


class Least(NamedTuple):
    """What the rounds came to."""

    internal: Array
    """h ``(3n,)``."""
    converged: Array
    hopeless: Array
    steps: Array


class _Round(NamedTuple):
    internal: Array
    multiplier: Array
    rho: Array
    apart: Array
    hopeless: Array
    rounds: Array
    steps: Array


class _Inner(NamedTuple):
    internal: Array
    slope: Array
    steps: Array


def least_internal(problem: ScaledBatch, parts: Internal, max_rounds: int) -> Least:
    """Rounds until forces meet their cones, or the multipliers prove that they cannot."""
    nothing = jnp.zeros_like(parts.particular)
    inside = jnp.linalg.norm(_shadow(problem, -parts.particular)[0]) <= CLOSE
    zero = jnp.zeros((), int)
    start = _Round(nothing, nothing, jnp.ones(()), jnp.where(inside, 0.0, jnp.inf), ~parts.reached, zero, zero)

    def going(state: _Round) -> Array:
        return (state.apart > CLOSE) & ~state.hopeless & (state.rounds < max_rounds)

    def next_round(state: _Round) -> _Round:
        inner = _minimise(problem, parts, state)
        multiplier, _ = _shadow(problem, state.multiplier - state.rho * (parts.particular + inner.internal))
        return _Round(
            internal=inner.internal,
            multiplier=multiplier,
            rho=jnp.minimum(RAISE * state.rho, STIFFEST),
            apart=jnp.linalg.norm(multiplier - state.multiplier) / state.rho,
            hopeless=_is_hopeless(parts, multiplier),
            rounds=state.rounds + 1,
            steps=state.steps + inner.steps,
        )

    end = jax.lax.while_loop(going, next_round, start)
    return Least(end.internal, end.apart <= CLOSE, end.hopeless, end.steps)


def _is_hopeless(parts: Internal, multiplier: Array) -> Array:
    """Whether any allowed forces would need |h| of at least ``FAR``: p.f >= 0 asks for p.h >= -p.particular."""
    lacking = -(multiplier @ parts.particular)
    pull = jnp.linalg.norm(parts.projection @ multiplier)
    clear = lacking > 1e-8 * jnp.linalg.norm(multiplier) * jnp.linalg.norm(parts.particular)
    return clear & (lacking > FAR * pull)


def _minimise(problem: ScaledBatch, parts: Internal, state: _Round) -> _Inner:
    """Newton's method with halved steps, from the last round's internal forces on."""

    def value(h: Array) -> Array:
        q, _ = _shadow(problem, state.multiplier - state.rho * (parts.particular + h))
        return h @ h / 2 + q @ q / (2 * state.rho)

    def slope_and_curvature(h: Array) -> tuple[Array, Array, Array]:
        q, bend = _shadow(problem, state.multiplier - state.rho * (parts.particular + h))
        within = parts.projection
        curved = jnp.eye(len(h)) + state.rho * within @ bend @ within
        return h - within @ q, curved, FLAT * jnp.maximum(1.0, jnp.linalg.norm(q))

    def going(inner: _Inner) -> Array:
        return (inner.slope > 1.0) & (inner.steps < NEWTON_STEPS)

    def step(inner: _Inner) -> _Inner:
        h = inner.internal
        slope, curved, _ = slope_and_curvature(h)
        way = parts.projection @ jnp.linalg.solve(curved, -slope)
        now, fall = value(h), slope @ way
        shares = 0.5 ** jnp.arange(HALVINGS)
        # Near the minimum rounding hides what a full step gains.
        enough = jax.vmap(lambda t: value(h + t * way) <= now + 1e-4 * t * fall + 1e-14 * jnp.abs(now))(shares)
        h = h + jnp.where(enough.any(), shares[jnp.argmax(enough)], 0) * way
        slope, _, flat = slope_and_curvature(h)
        return _Inner(h, jnp.linalg.norm(slope) / flat, inner.steps + 1)

    return jax.lax.while_loop(going, step, _Inner(state.internal, jnp.array(jnp.inf), jnp.zeros((), int)))


def _shadow(problem: ScaledBatch, u: Array) -> tuple[Array, Array]:
    """The projection of each contact's part of u on the dual of its cone, and its derivative ``(3n, 3n)``.

    By Moreau's decomposition it is u plus the projection of -u on the cone itself.
    """
    n = len(problem.friction)
    opposite = ContactVec(vec3.from_axis(-u.reshape(n, 3), -1))
    cone = Cone(vec3.from_axis(problem.normals, -1), problem.friction)
    parts = friction_cone.decompose(opposite, cone)
    on_cone = jnp.stack(friction_cone.project(opposite, cone, parts).linear, -1)
    lower = friction_cone.derivative(cone, parts)
    each = jnp.stack([jnp.stack([lower[max(i, j)][min(i, j)] for j in range(3)], -1) for i in range(3)], -2)
    blocks = jnp.eye(3) - each
    wide = jnp.zeros((n, 3, n, 3)).at[jnp.arange(n), :, jnp.arange(n)].set(blocks)
    return u + on_cone.ravel(), wide.reshape(3 * n, 3 * n)
