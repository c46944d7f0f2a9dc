"""Nakamura, Nagai and Yoshikawa: the least internal forces that keep every contact from slipping.

Y. Nakamura, K. Nagai and T. Yoshikawa, "Dynamics and stability in coordination of multiple robotic mechanisms", Int.
J. Robotics Research 8(2), 1989: forces are those of the pseudo-inverse, which balance the wrench, and internal forces
from the null space of the grasp matrix; of the internal forces within the true friction cones those of least norm are
found, a nonlinear program that they solve by Lagrange multipliers.

Reconstructed from descriptions in later work. The solver is a choice made here: the method of multipliers (M. R.
Hestenes 1969, M. J. D. Powell 1969) for cones, where a multiplier is a vector of the dual cone, with Newton steps
inside.

The two parts are orthogonal, so that these are the forces of least norm altogether: the constrained optimum without
squeezing forces, shared uniformly.

Failures: the least forces have no margin; a contact that slips at the pseudo-inverse ends on its cone, and one
that would pull is let go, at the cone's apex. Near the limit of what contacts can exert the multipliers grow without
end and steps run out.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus, read_input
from jaxgrasp.literature.scaled_problems import BatchResult, Internal, ScaledBatch, internal, solve_all
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec3
from jaxgrasp.problem import friction_cone
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.friction_cone import Cone
from jaxgrasp.validation.checked import checked


@checked
def nakamura(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    max_rounds: int = 60,
    throw: bool = True,
) -> MethodAnswer:
    """Compute the pseudo-inverse's forces, plus the internal forces of least norm that bring them into the friction
    cones.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        max_rounds: largest number of updates of the multipliers.
        throw: whether invalid values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer, all problems in one call. The objective is the norm of the internal forces [N]; iterations are
        Newton steps, none where the pseudo-inverse is inside the cones. INFEASIBLE where no forces give the wrench,
        or where the multipliers prove that internal forces would have to be a million times the load.

    Raises:
        ValueError: for an invalid argument.
        GraspError: for invalid data, by name of the entry.
    """
    if max_rounds < 1:
        raise ValueError(f"max_rounds is {max_rounds}: expected 1 or more")
    problems = read_input(grasp, wrench, throw=throw)
    return solve_all(problems, lambda problem, load: _solve(problem, max_rounds), unit=1)


@partial(jax.jit, static_argnames="max_rounds")
def _solve(problem: ScaledBatch, max_rounds: int) -> BatchResult:
    return jax.vmap(partial(_solve_single, max_rounds=max_rounds))(problem)


def _solve_single(problem: ScaledBatch, max_rounds: int) -> BatchResult:
    parts = internal(problem)
    result = least_internal(problem, parts, max_rounds)
    forces = parts.balanced(parts.particular + result.internal, problem.wrench)
    status = jnp.where(result.converged, MethodStatus.SOLVED, MethodStatus.NOT_CONVERGED)
    is_infeasible = ~parts.reached | (result.hopeless & ~result.converged)
    return BatchResult(
        forces=forces.reshape(-1, 3),
        status=jnp.where(is_infeasible, MethodStatus.INFEASIBLE, status),
        objective=jnp.linalg.norm(result.internal),
        iterations=result.steps,
    )


RAISE, STIFFEST = 4.0, 1e6
"""Factor on rho after each round, from 1 on, and the largest rho: beyond it rounding spoils the Newton steps."""
CLOSE = 1e-11
"""Distance of forces from their cones, in units of the load, at which a round is the last."""
FLAT = 1e-12
"""Slope, relative to the multipliers, at which Newton's method ends."""
NEWTON_STEPS, HALVINGS = 40, 30
FAR = 1e6
"""Size of internal forces, in units of the load, that multipliers must prove necessary before the problem counts as
infeasible."""


class Least(NamedTuple):
    """Result of the method of multipliers."""

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
    """Minimise |h|^2 / 2 over internal forces h such that every force of f = particular + h lies in its cone K.

    The method of multipliers: with multipliers p in the dual cones, each round minimises |h|^2 / 2 + |q|^2 / (2 rho), q
    the projection of p - rho f on the dual cones, by Newton's method, takes q for p, and raises rho. It ends when the
    forces meet their cones, or the multipliers prove that they cannot.
    """
    zeros = jnp.zeros_like(parts.particular)
    is_inside = jnp.linalg.norm(_project_on_dual(problem, -parts.particular)[0]) <= CLOSE
    zero = jnp.zeros((), int)
    start = _Round(zeros, zeros, jnp.ones(()), jnp.where(is_inside, 0.0, jnp.inf), ~parts.reached, zero, zero)

    def is_running(state: _Round) -> Array:
        return (state.apart > CLOSE) & ~state.hopeless & (state.rounds < max_rounds)

    def next_round(state: _Round) -> _Round:
        inner = _minimise(problem, parts, state)
        multiplier, _ = _project_on_dual(problem, state.multiplier - state.rho * (parts.particular + inner.internal))
        return _Round(
            internal=inner.internal,
            multiplier=multiplier,
            rho=jnp.minimum(RAISE * state.rho, STIFFEST),
            apart=jnp.linalg.norm(multiplier - state.multiplier) / state.rho,
            hopeless=_is_hopeless(parts, multiplier),
            rounds=state.rounds + 1,
            steps=state.steps + inner.steps,
        )

    end = jax.lax.while_loop(is_running, next_round, start)
    return Least(end.internal, end.apart <= CLOSE, end.hopeless, end.steps)


def _is_hopeless(parts: Internal, multiplier: Array) -> Array:
    """Return whether allowed forces would need |h| of at least ``FAR``: p.f >= 0 requires p.h >= -p.particular."""
    lacking = -(multiplier @ parts.particular)
    pull = jnp.linalg.norm(parts.projection @ multiplier)
    clear = lacking > 1e-8 * jnp.linalg.norm(multiplier) * jnp.linalg.norm(parts.particular)
    return clear & (lacking > FAR * pull)


def _minimise(problem: ScaledBatch, parts: Internal, state: _Round) -> _Inner:
    """Run Newton's method with halved steps, from the last round's internal forces."""

    def value(h: Array) -> Array:
        q, _ = _project_on_dual(problem, state.multiplier - state.rho * (parts.particular + h))
        return h @ h / 2 + q @ q / (2 * state.rho)

    def slope_and_curvature(h: Array) -> tuple[Array, Array, Array]:
        q, bend = _project_on_dual(problem, state.multiplier - state.rho * (parts.particular + h))
        within = parts.projection
        curved = jnp.eye(len(h)) + state.rho * within @ bend @ within
        return h - within @ q, curved, FLAT * jnp.maximum(1.0, jnp.linalg.norm(q))

    def is_running(inner: _Inner) -> Array:
        return (inner.slope > 1.0) & (inner.steps < NEWTON_STEPS)

    def step(inner: _Inner) -> _Inner:
        h = inner.internal
        slope, curved, _ = slope_and_curvature(h)
        direction = parts.projection @ jnp.linalg.solve(curved, -slope)
        current, fall = value(h), slope @ direction
        shares = 0.5 ** jnp.arange(HALVINGS)
        # Near the minimum rounding hides the decrease of a full step.
        decreases = jax.vmap(
            lambda t: value(h + t * direction) <= current + 1e-4 * t * fall + 1e-14 * jnp.abs(current)
        )(shares)
        h = h + jnp.where(decreases.any(), shares[jnp.argmax(decreases)], 0) * direction
        slope, _, flat = slope_and_curvature(h)
        return _Inner(h, jnp.linalg.norm(slope) / flat, inner.steps + 1)

    return jax.lax.while_loop(is_running, step, _Inner(state.internal, jnp.array(jnp.inf), jnp.zeros((), int)))


def _project_on_dual(problem: ScaledBatch, u: Array) -> tuple[Array, Array]:
    """Project each contact's part of u onto the dual of its cone; return the derivative ``(3n, 3n)`` too.

    By Moreau's decomposition it is u plus the projection of -u on the cone itself.
    """
    n = len(problem.friction)
    opposite = ContactVec(vec3.from_axis(-u.reshape(n, 3), -1))
    cone = Cone(vec3.from_axis(problem.normals, -1), problem.friction)
    parts = friction_cone.decompose(opposite, cone)
    on_cone = jnp.stack(friction_cone.project(opposite, cone, parts).linear, -1)
    lower = friction_cone.derivative(cone, parts)
    jacobian = jnp.stack([jnp.stack([lower[max(i, j)][min(i, j)] for j in range(3)], -1) for i in range(3)], -2)
    blocks = jnp.eye(3) - jacobian
    blocks_on_diagonal = jnp.zeros((n, 3, n, 3)).at[jnp.arange(n), :, jnp.arange(n)].set(blocks)
    return u + on_cone.ravel(), blocks_on_diagonal.reshape(3 * n, 3 * n)
