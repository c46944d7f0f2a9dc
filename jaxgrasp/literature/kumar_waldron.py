"""Kumar and Waldron: equilibrating forces without interaction, and the least interaction that friction asks for.

V. R. Kumar and K. J. Waldron, "Force distribution in closed kinematic chains", IEEE J. Robotics and Automation 4(6),
1988. Equilibrating forces balance the wrench and have no interaction component: along the line that joins two
contacts their difference vanishes. Such forces form a helicoidal field, like the velocities of a rigid body, and are
those of the pseudo-inverse. Interaction forces act along these lines in opposite pairs and balance to zero; they are
superposed in a way that is fast rather than optimal. In their gripper paper of the same years (V. Kumar and K. J.
Waldron, "Sub-optimal algorithms for force distribution in multifingered grippers") these are chosen as if all normals
passed through the centroid of the contacts.

Reconstructed from abstracts and from descriptions in later work; made here is the choice that follows from that
assumption: the
pull between two contacts grows with their distance, so that every contact is pressed towards the centroid. For four
contacts or fewer, not in a line, nothing else meets there without torque. One number is left, the strength of the
interaction: the least for which all forces lie in their true cones, found in closed form contact by contact.

Failures: where a normal leans away from the centroid by more than the angle of friction, more interaction makes
that contact slip, and no strength may suit all contacts although allowed forces exist: OUTSIDE_CONES, with the
equilibrating forces alone. Nothing limits the interaction where a normal only just embraces the centroid. The least
strength leaves a contact on its cone, without a margin.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus, read_input
from jaxgrasp.literature.scaled_problems import BatchResult, ScaledBatch, solve_all
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked

RANK_CUT = 1e-11
"""Relative size below whose square moments of inertia, in units of the contacts' radius, are those of a line or a
point."""
REACH = 1e-9
"""Largest unbalanced part of a feasible wrench, relative to it."""
ALLOWED = 1e-9
"""Distance that a force may lie beyond its cone, in units of the load: the closed form puts it on the cone."""


@checked
def kumar_waldron(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    safety: float = 1.0,
    throw: bool = True,
) -> MethodAnswer:
    """Compute equilibrating forces, plus the least interaction towards the contacts' centroid that keeps all from
    slipping.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        safety: friction is divided by this, since the least interaction leaves no margin: 1 or more.
        throw: whether invalid values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer, all problems in one call: SOLVED inside the cones; OUTSIDE_CONES with the equilibrating forces
        where no strength of the interaction suits all contacts; INFEASIBLE where no forces at all, allowed or not,
        give the wrench. The objective is the largest interaction force [N]; there are no iterations.

    Raises:
        ValueError: for an invalid argument.
        GraspError: for invalid data, by name of the entry.
    """
    if not 1 <= safety < np.inf:
        raise ValueError(f"safety is {safety}: expected a finite number, 1 or more")
    problems = read_input(grasp, wrench, throw=throw)
    return solve_all(problems, partial(_solve, safety=safety), unit=1)


@jax.jit
def _solve(problem: ScaledBatch, load: Array, safety: Array | float) -> BatchResult:
    friction = problem.friction / safety
    forces = equilibrating_forces(problem)
    low, high = _strengths(forces, -problem.arms, problem.normals, friction)
    is_present = problem.present > 0.5
    least = jnp.max(jnp.where(is_present, low, 0), -1, initial=0)
    largest = jnp.min(jnp.where(is_present, high, jnp.inf), -1, initial=jnp.inf)
    strength = jnp.where(jnp.isfinite(least), least, 0)
    with_interaction = forces - strength[:, None, None] * problem.arms
    is_solved = (least <= largest) & jnp.all(~is_present | _inside(with_interaction, problem.normals, friction), -1)
    residual = jnp.linalg.norm(_unbalanced(problem, forces), axis=-1)
    reached = residual <= jnp.maximum(
        REACH * jnp.linalg.norm(problem.wrench, axis=-1), 64 * jnp.finfo(residual.dtype).eps
    )
    status = jnp.where(is_solved, MethodStatus.SOLVED, MethodStatus.OUTSIDE_CONES)
    strongest = strength * jnp.max(jnp.linalg.norm(problem.arms, axis=-1), -1)
    return BatchResult(
        forces=jnp.where(is_solved[:, None, None], with_interaction, forces),
        status=jnp.where(reached, status, MethodStatus.INFEASIBLE),
        objective=jnp.where(is_solved, strongest, 0),
        iterations=jnp.zeros(len(residual), int),
    )


def equilibrating_forces(problem: ScaledBatch) -> Array:
    """Compute the helicoidal field ``(B, n, 3)``: a force common to all, plus a vector crossed with each arm.

    About the centroid the first follows from the force alone, and the second from the torque through the tensor of
    inertia of the contacts, each of mass one.
    """
    # Moments as sums of squares: a difference would cancel for contacts near a line.
    padded_arms = jnp.pad(problem.arms, ((0, 0), (0, max(3 - problem.arms.shape[1], 0)), (0, 0)))
    _, spread, axes = jnp.linalg.svd(padded_arms, full_matrices=False)
    x, y, z = (spread[:, i] ** 2 for i in range(3))
    moments = jnp.stack([y + z, x + z, x + y], -1)
    is_turned = moments > RANK_CUT**2
    by_torque = jnp.where(is_turned, 1 / jnp.where(is_turned, moments, 1), 0)
    forces = _field(problem, problem.wrench, axes, by_torque)
    # One refinement balances the wrench to rounding, however close to a line the contacts are.
    return forces + _field(problem, _unbalanced(problem, forces), axes, by_torque)


def _field(problem: ScaledBatch, wrench: Array, axes: Array, by_torque: Array) -> Array:
    count = jnp.maximum(problem.present.sum(-1, keepdims=True), 1)
    spin = jnp.einsum("bij,bi->bj", axes, by_torque * jnp.einsum("bij,bj->bi", axes, wrench[:, 3:]))
    field = (wrench[:, :3] / count)[:, None] + jnp.cross(spin[:, None], problem.arms)
    return problem.present[..., None] * field


def _unbalanced(problem: ScaledBatch, forces: Array) -> Array:
    resultant = jnp.concatenate([forces.sum(1), jnp.cross(problem.arms, forces).sum(1)], -1)
    return problem.wrench - resultant


def _strengths(forces: Array, towards: Array, normals: Array, friction: Array) -> tuple[Array, Array]:
    """Compute for each contact the interval of strengths x >= 0 with f + x u in its cone; (inf, -inf) where it is
    empty.

    The cone is convex, so there is one interval: between, or beyond, the roots of
    mu^2 (f_n + x u_n)^2 - |f_t + x u_t|^2 = a x^2 + 2 b x + c, where the normal force does not pull.
    """
    f_n, u_n = jnp.sum(forces * normals, -1), jnp.sum(towards * normals, -1)
    f_t, u_t = forces - f_n[..., None] * normals, towards - u_n[..., None] * normals
    a = friction**2 * u_n**2 - jnp.sum(u_t**2, -1)
    b = friction**2 * f_n * u_n - jnp.sum(f_t * u_t, -1)
    c = friction**2 * f_n**2 - jnp.sum(f_t**2, -1)
    first, second, real = _roots(a, b, c)
    # Towards the inside of the cone: from the larger root on; away from it: up to the smaller one.
    low = jnp.where(a > 0, jnp.where(u_n > 0, second, 0), first)
    high = jnp.where(a > 0, jnp.where(u_n > 0, jnp.inf, first), second)
    # A contact in the centroid gets no interaction force.
    is_central = jnp.sum(towards**2, -1) == 0
    is_inside = _inside(forces, normals, friction)
    low, high = jnp.where(is_central, 0, jnp.maximum(low, 0)), jnp.where(is_central, jnp.inf, high)
    middle = jnp.where(jnp.isfinite(high), (low + high) / 2, low)
    exists = jnp.where(is_central, is_inside, real & (low <= high) & (f_n + middle * u_n >= 0))
    return jnp.where(exists, low, jnp.inf), jnp.where(exists, high, -jnp.inf)


def _roots(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
    """Solve a x^2 + 2 b x + c = 0: the roots, the smaller first, and whether they are real; infinite where a
    vanishes."""
    gap = b * b - a * c
    is_real = gap >= 0
    # The stable form, without cancellation.
    q = -(b + jnp.where(b < 0, -1, 1) * jnp.sqrt(jnp.where(is_real, gap, 0)))
    first = jnp.where(a == 0, jnp.sign(q) * jnp.inf, q / jnp.where(a == 0, 1, a))
    second = jnp.where(q == 0, 0, c / jnp.where(q == 0, 1, q))
    return jnp.minimum(first, second), jnp.maximum(first, second), is_real


def _inside(forces: Array, normals: Array, friction: Array) -> Array:
    along = jnp.sum(forces * normals, -1)
    across = jnp.linalg.norm(forces - along[..., None] * normals, axis=-1)
    return across <= friction * along + ALLOWED
