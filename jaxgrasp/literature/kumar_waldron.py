"""Kumar and Waldron: equilibrating forces without interaction, and the least interaction that friction asks for.

V. R. Kumar and K. J. Waldron, "Force distribution in closed kinematic chains", IEEE J. Robotics and Automation 4(6),
1988. Equilibrating forces balance the wrench and have no interaction component: along the line that joins two
contacts their difference vanishes. Such forces form a helicoidal field, like the velocities of a rigid body, and are
those of the pseudo-inverse. Interaction forces act along these lines in opposite pairs and balance to zero; they are
superposed in a way that is fast rather than optimal. In their gripper paper of the same years (V. Kumar and K. J.
Waldron, "Sub-optimal algorithms for force distribution in multifingered grippers") these are chosen as if all normals
passed through the centroid of the contacts.

Known from abstracts and from descriptions in later work; ours is the choice that follows from that assumption: the
pull between two contacts grows with their distance, so that every contact is pressed towards the centroid. For four
contacts or fewer, not in a line, nothing else meets there without torque. One number is left, the strength of the
interaction: the least for which all forces lie in their true cones, found in closed form contact by contact.

How it fails: where a normal leans away from the centroid by more than the angle of friction, more interaction makes
that contact slip, and no strength may suit all contacts although allowed forces exist: OUTSIDE_CONES, with the
equilibrating forces alone. Nothing limits the interaction where a normal only just embraces the centroid. The least
strength leaves a contact on its cone, without a margin.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.batch_problem import BatchResult, solve_all
from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.scaled_batch import ScaledBatch
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked

RANK_CUT = 1e-11
"""Moments of inertia below the square of this, the contacts' radius being one, are those of a line or a point."""
REACH = 1e-9
"""Part of a wrench that forces may leave unbalanced, relative to it, before it counts as out of reach."""
ALLOWED = 1e-9
"""How far a force may lie beyond its cone, the load being one: a closed form that is chosen to lie on it."""


@checked
def kumar_waldron(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    safety: float = 1.0,
    throw: bool = True,
) -> MethodAnswer:
    """Equilibrating forces, and the least interaction towards the contacts' centroid that keeps all from slipping.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        safety: friction is divided by this, since the least interaction leaves no margin: 1 or more.
        throw: whether bad values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer, all problems in one call: SOLVED inside the cones; OUTSIDE_CONES with the equilibrating forces
        where no strength of the interaction suits all contacts; INFEASIBLE where no forces at all, allowed or not,
        give the wrench. The objective is the largest interaction force [N]; there are no iterations.

    Raises:
        ValueError: for an argument that cannot be used.
        GraspError: for data that cannot be used, naming the entry.
    """
    if not 1 <= safety < np.inf:
        raise ValueError(f"safety is {safety}: expected a finite number, 1 or more")
    given = read_input(grasp, wrench, throw=throw)
    return solve_all(given, partial(_solve, safety=safety), unit=1)


@jax.jit
def _solve(problem: ScaledBatch, load: Array, safety: Array | float) -> BatchResult:
    friction = problem.friction / safety
    forces = equilibrating_forces(problem)
    low, high = _strengths(forces, -problem.arms, problem.normals, friction)
    there = problem.present > 0.5
    least = jnp.max(jnp.where(there, low, 0), -1, initial=0)
    most = jnp.min(jnp.where(there, high, jnp.inf), -1, initial=jnp.inf)
    strength = jnp.where(jnp.isfinite(least), least, 0)
    pressed = forces - strength[:, None, None] * problem.arms
    held = (least <= most) & jnp.all(~there | _inside(pressed, problem.normals, friction), -1)
    rest = jnp.linalg.norm(_unbalanced(problem, forces), axis=-1)
    reached = rest <= jnp.maximum(REACH * jnp.linalg.norm(problem.wrench, axis=-1), 64 * jnp.finfo(rest.dtype).eps)
    status = jnp.where(held, MethodStatus.SOLVED, MethodStatus.OUTSIDE_CONES)
    strongest = strength * jnp.max(jnp.linalg.norm(problem.arms, axis=-1), -1)
    return BatchResult(
        forces=jnp.where(held[:, None, None], pressed, forces),
        status=jnp.where(reached, status, MethodStatus.INFEASIBLE),
        objective=jnp.where(held, strongest, 0),
        iterations=jnp.zeros(len(rest), int),
    )


def equilibrating_forces(problem: ScaledBatch) -> Array:
    """The helicoidal field ``(B, n, 3)``: one force for all, and one vector that each arm is crossed with.

    About the centroid the first follows from the force alone, and the second from the torque through the tensor of
    inertia of the contacts, each of mass one.
    """
    # Moments as sums of squares: those of contacts near a line would be lost in a difference.
    three = jnp.pad(problem.arms, ((0, 0), (0, max(3 - problem.arms.shape[1], 0)), (0, 0)))
    _, spread, axes = jnp.linalg.svd(three, full_matrices=False)
    x, y, z = (spread[:, i] ** 2 for i in range(3))
    moments = jnp.stack([y + z, x + z, x + y], -1)
    turns = moments > RANK_CUT**2
    by_torque = jnp.where(turns, 1 / jnp.where(turns, moments, 1), 0)
    forces = _field(problem, problem.wrench, axes, by_torque)
    # Once more, so that the wrench is balanced to rounding however close to a line the contacts are.
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
    """For each contact the interval of strengths x >= 0 with f + x u in its cone; (inf, -inf) where there is none.

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
    # A contact in the centroid feels no interaction, and must do without.
    still = jnp.sum(towards**2, -1) == 0
    fine = _inside(forces, normals, friction)
    low, high = jnp.where(still, 0, jnp.maximum(low, 0)), jnp.where(still, jnp.inf, high)
    middle = jnp.where(jnp.isfinite(high), (low + high) / 2, low)
    exists = jnp.where(still, fine, real & (low <= high) & (f_n + middle * u_n >= 0))
    return jnp.where(exists, low, jnp.inf), jnp.where(exists, high, -jnp.inf)


def _roots(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
    """The roots of a x^2 + 2 b x + c, the smaller first, and whether there are any; infinite where a vanishes."""
    gap = b * b - a * c
    real = gap >= 0
    # Without a difference of like numbers.
    q = -(b + jnp.where(b < 0, -1, 1) * jnp.sqrt(jnp.where(real, gap, 0)))
    one = jnp.where(a == 0, jnp.sign(q) * jnp.inf, q / jnp.where(a == 0, 1, a))
    other = jnp.where(q == 0, 0, c / jnp.where(q == 0, 1, q))
    return jnp.minimum(one, other), jnp.maximum(one, other), real


def _inside(forces: Array, normals: Array, friction: Array) -> Array:
    along = jnp.sum(forces * normals, -1)
    across = jnp.linalg.norm(forces - along[..., None] * normals, axis=-1)
    return across <= friction * along + ALLOWED
