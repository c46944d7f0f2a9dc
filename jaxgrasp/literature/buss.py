"""Buss, Hashimoto and Moore: friction cones as positive definite matrices, effort traded against margin.

M. Buss, H. Hashimoto and J. B. Moore, "Dextrous hand grasping force optimization", IEEE Trans. Robotics and Automation
12(3), 1996: with P_i = [[mu f_n, 0, f_1], [0, mu f_n, f_2], [f_1, f_2, mu f_n]] for the force of contact i in its own
axes, the force lies inside the true cone exactly where P_i is positive definite. The balance of forces is linear in
P = diag(P_i). They minimise tr(W_p P) + tr(W_b P^-1), effort and a barrier that keeps a margin, by a gradient flow
within the linear constraints, which a strictly feasible start never leaves. M. Buss, L. Faybusovich and J. B. Moore,
"Dikin-type algorithms for dextrous grasping force optimization", Int. J. Robotics Research 17(8), 1998, measure
gradients by P^-1, as Dikin's ellipsoids do, with far fewer steps.

Reconstructed from descriptions in later work. Choices made here: both weights are multiples of the identity; steps are
the best of a geometric series, from far outside Dikin's ellipsoid to well inside it; and the start, for which the same
Dikin steps lower s in P + s I > 0 until s < 0, or until their multipliers prove that it cannot be.

Failures: a contact without friction, or one that can carry no force, leaves nothing strictly inside the cones:
then there is no start (INFEASIBLE, or NOT_CONVERGED without a proof), though allowed forces may exist. The gradient
flow crawls; either flow ends where its value falls no more, which leaves forces right to about a millionth. The
trade-off has a unit, so that what is a fair margin for one load is none for a larger one.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus, read_input
from jaxgrasp.literature.scaled_problems import BatchResult, Internal, ScaledBatch, internal, solve_all
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked


@checked
def buss(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    effort: float = 1.0,
    margin: float = 1.0,
    flow: Literal["dikin", "gradient"] = "dikin",
    max_steps: int = 500,
    throw: bool = True,
) -> MethodAnswer:
    """Compute forces of least effort tr(P) + margin tr(P^-1), strictly inside the friction cones.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        effort: weight of tr(P), three times the sum of mu f_n, above 0.
        margin: weight of tr(P^-1), above 0 [N^2]: the larger, the farther from slipping, and the harder the grip.
        flow: ``"dikin"`` (1998), or ``"gradient"`` (1996), which takes very many steps.
        max_steps: largest number of steps of the flow, and of the search for its start.
        throw: whether invalid values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer, all problems in one call, whose objective is the weighted sum [N], and whose iterations are
        steps, with those to the start.

    Raises:
        ValueError: for an invalid argument.
        GraspError: for invalid data, by name of the entry.
    """
    for name, weight in (("effort", effort), ("margin", margin)):
        if not 0 < weight < np.inf:
            raise ValueError(f"{name} is {weight}: expected a finite number above 0")
    if flow not in ("dikin", "gradient"):
        raise ValueError(f"flow is {flow!r}: expected 'dikin' or 'gradient'")
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}: expected 1 or more")
    problems = read_input(grasp, wrench, throw=throw)
    # In units of the load the margin's weight, a square of forces, shrinks with the load's square.
    return solve_all(
        problems,
        lambda problem, load: _solve(problem, jnp.full_like(load, effort), margin / load**2, flow, max_steps),
        unit=1,
    )


@partial(jax.jit, static_argnames=("flow", "max_steps"))
def _solve(problem: ScaledBatch, effort: Array, margin: Array, flow: str, max_steps: int) -> BatchResult:
    return jax.vmap(partial(_solve_single, flow=flow, max_steps=max_steps))(problem, effort, margin)


def _solve_single(problem: ScaledBatch, effort: Array, margin: Array, flow: str, max_steps: int) -> BatchResult:
    parts = internal(problem)
    axes = cone_coordinates(problem)
    start = first_inside(problem, parts, axes, max_steps)
    inside = start.is_found & parts.reached
    end = descend(problem, parts, axes, Trade(effort, margin), start.internal, inside, flow == "gradient", max_steps)
    forces = parts.balanced(parts.particular + end.internal, problem.wrench)
    is_infeasible = ~parts.reached | (start.hopeless & ~start.is_found)
    # A wrench of zero needs no contacts.
    is_empty = ~(problem.present > 0.5).any()
    solved = jnp.where(inside & end.converged, MethodStatus.SOLVED, MethodStatus.NOT_CONVERGED)
    status = jnp.where(is_infeasible, MethodStatus.INFEASIBLE, jnp.where(is_empty, MethodStatus.SOLVED, solved))
    return BatchResult(forces.reshape(-1, 3), status, jnp.where(is_empty, 0, end.value), start.steps + end.steps)


LONGEST, SHORTEST = 6, -30
"""Exponents of two: range of step lengths, in radii of Dikin's ellipsoid."""
BRISK = 0.9
"""Part of a step that would just reach the boundary."""
ROOM = 0.05
"""Distance of a start inside the cones, in units of the load; a smaller one is accepted where no larger exists."""
FLAT = 1e-9
"""Slope along internal forces, relative to that of the two terms, at which a flow ends."""
FAR = 1e6
"""Size of internal forces, in units of the load, that multipliers must prove necessary before the problem counts as
infeasible."""
RIDGE = 1e-13
"""Regularisation of a metric where a coordinate has no effect, relative to its largest entry."""


class Trade(NamedTuple):
    """Weights of tr(P) and of tr(P^-1)."""

    effort: Array
    margin: Array


class Start(NamedTuple):
    """Result of the search for a strictly feasible start."""

    internal: Array
    is_found: Array
    hopeless: Array
    steps: Array


class End(NamedTuple):
    """Result of a flow."""

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


def cone_coordinates(problem: ScaledBatch) -> Array:
    """Return the matrix ``(3n, 3n)`` from all forces to g of all contacts; zero for absent contacts."""
    n = len(problem.friction)
    farthest = jnp.eye(3)[jnp.argmin(jnp.abs(problem.normals), -1)]
    first = jnp.cross(problem.normals, farthest)
    size = jnp.linalg.norm(first, axis=-1, keepdims=True)
    first = first / jnp.where(size > 0, size, 1)
    rows = jnp.stack([problem.friction[:, None] * problem.normals, first, jnp.cross(problem.normals, first)], 1)
    return jnp.zeros((n, 3, n, 3)).at[jnp.arange(n), :, jnp.arange(n)].set(rows).reshape(3 * n, 3 * n)


def first_inside(problem: ScaledBatch, parts: Internal, axes: Array, max_steps: int) -> Start:
    """Lower s in P + s I > 0 by Dikin steps, until P itself is positive definite with some margin."""
    constant, inward = axes @ parts.particular, jnp.zeros_like(axes[0]).at[::3].set(problem.present.repeat(3)[::3])
    linear = jnp.column_stack([axes @ parts.projection, inward])
    lack = jnp.max(jnp.linalg.norm(_per_contact(constant)[:, 1:], axis=-1) - constant[::3], initial=0.0)
    objective = jnp.zeros(len(constant) + 1).at[-1].set(1.0)
    zero = jnp.zeros((), int)
    start = _CentringState(
        jnp.zeros_like(constant), jnp.where(lack > -ROOM, 1.5 * lack + 0.5, -ROOM), zero > 0, zero > 0, zero
    )

    def is_running(state: _CentringState) -> Array:
        return (state.shift > -ROOM) & ~state.hopeless & ~state.stuck & (state.steps < max_steps)

    def step(state: _CentringState) -> _CentringState:
        coordinates = constant + linear @ jnp.append(state.internal, state.shift)
        curved = _blocks(jax.vmap(jax.hessian(_barrier))(_safe(coordinates, problem)))
        direction, radius = _steepest(linear.T @ curved @ linear, parts, objective)
        moves = radius * _lengths() * direction
        is_inside = jax.vmap(
            lambda move: _is_inside(constant + linear @ (jnp.append(state.internal, state.shift) + move), problem)
        )
        share = BRISK * jnp.where(is_inside(moves).any(), moves[jnp.argmax(is_inside(moves))], 0)
        multipliers = -curved @ linear @ direction
        return _CentringState(
            internal=state.internal + share[:-1],
            shift=state.shift + share[-1],
            hopeless=_is_hopeless(constant, multipliers, problem),
            stuck=-share[-1] <= 1e-14 * jnp.abs(state.shift),
            steps=state.steps + 1,
        )

    end = jax.lax.while_loop(is_running, step, start)
    is_found = (end.shift < 0) & _is_inside(constant + linear[:, :-1] @ end.internal, problem)
    return Start(end.internal, is_found, end.hopeless, end.steps)


def _is_hopeless(constant: Array, multipliers: Array, problem: ScaledBatch) -> Array:
    """Return whether multipliers q of the cones prove that s stays above zero: q.g >= 0 requires s >=
    -q.g(particular)."""
    q = _per_contact(multipliers)
    outside = jnp.max(jnp.where(problem.present > 0.5, jnp.linalg.norm(q[:, 1:], axis=-1) - q[:, 0], 0), initial=0.0)
    bound = -(multipliers @ constant)
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
    """Follow the gradient of the objective, measured by P^-1, or by the plain inner product of the matrices."""
    constant, linear = axes @ parts.particular, axes @ parts.projection
    is_present = problem.present > 0.5

    def value(internal: Array) -> Array:
        coordinates = constant + linear @ internal
        values_by_contact = jax.vmap(_index, (0, None))(_safe(coordinates, problem), trade)
        return jnp.where(
            _is_inside(coordinates, problem), jnp.sum(jnp.where(is_present, values_by_contact, 0)), jnp.inf
        )

    def slope_of(internal: Array) -> tuple[Array, Array]:
        coordinates = _safe(constant + linear @ internal, problem)
        terms = [jax.vmap(jax.grad(_index), (0, None))(coordinates, part) for part in _apart(trade)]
        effort, margin = (jnp.where(is_present[:, None], term, 0).ravel() for term in terms)
        size = jnp.linalg.norm(linear.T @ effort) + jnp.linalg.norm(linear.T @ margin)
        slope = linear.T @ (effort + margin)
        return slope, jnp.linalg.norm(slope) <= FLAT * size

    def is_running(state: End) -> Array:
        return inside & ~state.converged & (state.steps < max_steps)

    def step(state: End) -> End:
        slope, _ = slope_of(state.internal)
        coordinates = _safe(constant + linear @ state.internal, problem)
        curved = (
            jnp.tile(jnp.diag(jnp.array([3.0, 2.0, 2.0])), (len(coordinates), 1, 1)) if plain else _curved(coordinates)
        )
        direction, radius = _steepest(linear.T @ _blocks(curved) @ linear, parts, slope)
        moves = radius * _lengths() * direction
        values = jax.vmap(value)(state.internal + moves)
        best = jnp.argmin(values)
        better = values[best] < state.value
        internal = jnp.where(better, state.internal + moves[best], state.internal)
        # Where rounding hides any decrease, the slope alone decides.
        flat = slope_of(internal)[1] | ~better
        return End(internal, jnp.where(better, values[best], state.value), flat, state.steps + 1)

    return jax.lax.while_loop(is_running, step, End(start, value(start), slope_of(start)[1], jnp.zeros((), int)))


def _curved(coordinates: Array) -> Array:
    return jax.vmap(jax.hessian(_barrier))(coordinates)


def _steepest(metric: Array, parts: Internal, slope: Array) -> tuple[Array, Array]:
    """Compute the direction of steepest descent by a metric over internal forces, and the step of length one."""
    n = len(parts.particular)
    idle = jnp.zeros_like(metric).at[:n, :n].set(jnp.eye(n) - parts.projection)
    largest = jnp.max(jnp.diag(metric))
    solid = metric + largest * (idle + RIDGE * jnp.eye(len(metric)))
    direction = -jnp.linalg.solve(solid, slope)
    length = jnp.sqrt(jnp.maximum(direction @ metric @ direction, 0))
    return direction, jnp.where(length > 0, 1 / jnp.where(length > 0, length, 1), 0)


def _apart(trade: Trade) -> tuple[Trade, Trade]:
    return trade._replace(margin=0 * trade.margin), trade._replace(effort=0 * trade.effort)


def _index(g: Array, trade: Trade) -> Array:
    """Compute the weighted tr(P) + tr(P^-1) of a contact, whose eigenvalues are m and m plus or minus |t|."""
    m, square = g[0], g[1] ** 2 + g[2] ** 2
    return trade.effort * 3 * m + trade.margin * (1 / m + 2 * m / (m**2 - square))


def _barrier(g: Array) -> Array:
    """Compute -log det P of a contact: its second derivative is Dikin's metric."""
    return -jnp.log(g[0]) - jnp.log(g[0] ** 2 - g[1] ** 2 - g[2] ** 2)


def _is_inside(coordinates: Array, problem: ScaledBatch) -> Array:
    g = _per_contact(coordinates)
    return jnp.all((jnp.linalg.norm(g[:, 1:], axis=-1) < g[:, 0]) | (problem.present < 0.5))


def _safe(coordinates: Array, problem: ScaledBatch) -> Array:
    """Return g of each contact ``(n, 3)``, with the identity where P is not positive definite or the contact is
    absent."""
    g = _per_contact(coordinates)
    is_inside = (jnp.linalg.norm(g[:, 1:], axis=-1) < g[:, 0]) & (problem.present > 0.5)
    return jnp.where(is_inside[:, None], g, jnp.array([1.0, 0.0, 0.0]))


def _per_contact(coordinates: Array) -> Array:
    return coordinates.reshape(-1, 3)


def _blocks(blocks: Array) -> Array:
    """Place ``(n, 3, 3)`` along the diagonal of a matrix ``(3n, 3n)``."""
    n = len(blocks)
    return jnp.zeros((n, 3, n, 3)).at[jnp.arange(n), :, jnp.arange(n)].set(blocks).reshape(3 * n, 3 * n)


def _lengths() -> Array:
    return 2.0 ** jnp.arange(LONGEST, SHORTEST - 1, -1)[:, None]
