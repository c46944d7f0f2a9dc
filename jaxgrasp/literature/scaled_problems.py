"""Problems scaled to order one, and the two ways to solve a batch: each on the host, or all in one call by JAX.

Lengths are in units of the contacts' radius about their centroid, forces in units of the load.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.method_input import MethodAnswer, MethodInput, MethodStatus
from jaxgrasp.model.wrench import grasp_matrix
from jaxgrasp.numerics.geometry import centred, tangents


class ScaledBatch(NamedTuple):
    """B problems: lengths in radii about the centroid of the contacts that are present, forces in units of the load.

    Absent contacts stay in their place: ``present`` is 0 there, and so are arms, normals and friction. The arrays are
    NumPy's, or JAX's for methods that run there.
    """

    arms: Any
    """Points about the centroid ``(B, n, 3)`` [radius]."""
    normals: Any
    friction: Any
    present: Any
    wrench: Any


def scale(problems: MethodInput) -> tuple[ScaledBatch, np.ndarray]:
    """Scale the problems; return them and their loads ``(B,)`` [N]: squeezing forces, force, and torque over the
    radius."""
    centre, arms, radius = centred(problems.points, problems.present, numpy=np)
    away = np.linalg.norm(centre, axis=-1)
    # Coincident contacts have no radius.
    length = np.where(radius > 0, radius, np.where(away > 0, away, 1.0))
    force = problems.wrench[:, :3]
    torque = (problems.wrench[:, 3:] - np.cross(centre, force)) / length[:, None]
    load = problems.squeeze.sum(-1) + np.linalg.norm(force, axis=-1) + np.linalg.norm(torque, axis=-1)
    load = np.where(load > 0, load, 1.0)
    size = np.linalg.norm(problems.normals, axis=-1, keepdims=True)
    normals = problems.normals / np.where(size > 0, size, 1.0)
    wrench = np.concatenate([force, torque], -1) / load[:, None]
    return ScaledBatch(
        arms / length[:, None, None], normals, problems.friction, problems.present.astype(float), wrench
    ), load


RANK_CUT = 1e-11
"""Singular values of the scaled grasp matrix below this share of the largest count as zero."""
REACH = 1e-9
"""Largest unbalanced part of a feasible wrench, relative to it."""


class HostProblem(NamedTuple):
    """A problem of m present contacts; force vectors are flat ``(3m,)``, contact after contact."""

    contacts: np.ndarray
    """Indices of the caller's contacts ``(m,)``."""
    balance: np.ndarray
    """The grasp matrix ``(6, 3m)``."""
    wrench: np.ndarray
    normals: np.ndarray
    """``(m, 3)``."""
    tangents: np.ndarray
    """Two unit vectors across each normal ``(m, 2, 3)``, from the coordinate axis that is farthest from it."""
    friction: np.ndarray
    squeeze: np.ndarray
    normal_min: np.ndarray
    normal_max: np.ndarray
    torque_rows: np.ndarray
    """``(j, 3m)`` [m]: times forces and the load, joint torques."""
    torque_max: np.ndarray
    """[m]: in units of the load."""
    load: float
    """[N]: sum of squeezing forces, force, and torque over the radius."""


class Balance(NamedTuple):
    """General solution of the balance: all forces that give the wrench are ``particular + basis z``."""

    particular: np.ndarray
    """Forces of least norm ``(3m,)``: the pseudo-inverse part."""
    basis: np.ndarray
    """Orthonormal internal forces ``(3m, 3m - rank)``."""
    inverse: np.ndarray
    """The pseudo-inverse of the grasp matrix ``(3m, 6)``."""
    reached: bool
    """True if any forces, allowed or not, give the wrench."""


class HostResult(NamedTuple):
    """Result of a method for a problem; ``forces`` in units of the load, None where there are none."""

    status: MethodStatus
    forces: np.ndarray | None = None
    objective: float = 0.0
    iterations: int = 0


def host_problem(problems: MethodInput, scaled: ScaledBatch, load: float, index: int) -> HostProblem:
    """Extract a problem of the batch, with at least one contact."""
    contacts = np.flatnonzero(problems.present[index])
    normals = scaled.normals[index, contacts]
    return HostProblem(
        contacts=contacts,
        balance=_grasp_matrix(scaled.arms[index, contacts]),
        wrench=scaled.wrench[index],
        normals=normals,
        tangents=np.stack(tangents(normals, np), 1),
        friction=problems.friction[index, contacts],
        squeeze=problems.squeeze[index, contacts] / load,
        normal_min=problems.normal_min[index, contacts] / load,
        normal_max=problems.normal_max[index, contacts] / load,
        torque_rows=problems.torque_map[index, contacts].reshape(3 * len(contacts), -1).T,
        torque_max=problems.torque_max[index] / load,
        load=load,
    )


def _grasp_matrix(arms: np.ndarray) -> np.ndarray:
    """Build the grasp matrix ``(6, 3m)``: column 3i + j belongs to component j of force i."""
    units = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
    torques = np.cross(arms[:, None], units)
    return np.concatenate([units, torques], -1).reshape(-1, 6).T


def balanced(problem: HostProblem) -> Balance:
    """Compute the general solution of G f = w, by a singular value decomposition."""
    left, sizes, right = np.linalg.svd(problem.balance, full_matrices=True)
    rank = int(np.sum(sizes > RANK_CUT * sizes[0]))
    inverse = right[:rank].T @ (left[:, :rank] / sizes[:rank]).T
    particular = inverse @ problem.wrench
    residual = problem.wrench - problem.balance @ particular
    # One refinement balances the wrench to rounding, however close to a line the contacts are.
    particular = particular + inverse @ residual
    residual = np.linalg.norm(problem.wrench - problem.balance @ particular)
    # The load is 1: a wrench of the size of rounding counts as zero.
    reached = bool(residual <= max(REACH * np.linalg.norm(problem.wrench), 64 * np.finfo(float).eps))
    return Balance(particular, right[rank:].T, inverse, reached)


def solve_each(problems: MethodInput, solve: Callable[[HostProblem], HostResult]) -> MethodAnswer:
    """Solve the problems one after the other, on the host."""
    count, n = problems.friction.shape
    forces, objective = np.zeros((count, n, 3)), np.zeros(count)
    status, iterations = np.zeros(count, int), np.zeros(count, int)
    scaled, loads = scale(problems)
    for index in np.flatnonzero(problems.valid).tolist():
        if not problems.present[index].any():
            # A wrench of zero needs no contacts.
            status[index] = MethodStatus.INFEASIBLE if problems.wrench[index].any() else MethodStatus.SOLVED
            continue
        problem = host_problem(problems, scaled, float(loads[index]), index)
        result = solve(problem)
        status[index], objective[index], iterations[index] = result.status, result.objective, result.iterations
        if result.forces is not None:
            forces[index, problem.contacts] = problem.load * result.forces.reshape(-1, 3)
    return problems.answer(forces, status, objective, iterations)


class Internal(NamedTuple):
    """General solution for a problem of n contacts: forces ``particular + projection @ h`` for any h, flat
    ``(3n,)``."""

    matrix: Array
    """The grasp matrix ``(6, 3n)``, zero for absent contacts."""
    inverse: Array
    """Its pseudo-inverse."""
    particular: Array
    projection: Array
    """Orthogonal projection onto internal forces of present contacts ``(3n, 3n)``."""
    reached: Array
    """True if any forces, allowed or not, give the wrench."""

    def balanced(self, forces: Array, wrench: Array) -> Array:
        """Correct nearly balanced forces by the least change that balances them to rounding."""
        return forces + self.inverse @ (wrench - self.matrix @ forces)


def internal(problem: ScaledBatch) -> Internal:
    """Compute the general solution of G f = w for a problem, by a singular value decomposition, in JAX."""
    is_present = jnp.repeat(problem.present, 3)
    matrix = grasp_matrix(problem.arms) * is_present
    left, sizes, right = jnp.linalg.svd(matrix, full_matrices=False)
    is_nonzero = sizes > RANK_CUT * jnp.maximum(sizes[0], jnp.finfo(sizes.dtype).tiny)
    rows = jnp.where(is_nonzero[:, None], right, 0)
    inverse = (rows.T * jnp.where(is_nonzero, 1 / jnp.where(is_nonzero, sizes, 1), 0)) @ left.T
    particular = inverse @ problem.wrench
    particular = particular + inverse @ (problem.wrench - matrix @ particular)
    residual = jnp.linalg.norm(problem.wrench - matrix @ particular)
    size = jnp.linalg.norm(problem.wrench)
    # The load is 1: a wrench of the size of rounding counts as zero.
    reached = residual <= jnp.maximum(REACH * size, 64 * jnp.finfo(sizes.dtype).eps)
    return Internal(matrix, inverse, particular, jnp.diag(is_present) - rows.T @ rows, reached)


class BatchResult(NamedTuple):
    """Results of a method for a batch, forces in units of the load."""

    forces: Array
    status: Array
    objective: Array
    iterations: Array


def solve_all(problems: MethodInput, solve: Callable[[ScaledBatch, Array], BatchResult], unit: int) -> MethodAnswer:
    """Solve all problems in one call, in double precision whatever JAX's mode.

    Args:
        problems: the batch of problems.
        solve: function of the scaled problems and their loads [N] ``(B,)``.
        unit: power of the load by which the objective scales.
    """
    count, n = problems.friction.shape
    if count == 0:
        return problems.answer(np.zeros((0, n, 3)), np.zeros(0), np.zeros(0), np.zeros(0, int))
    with jax.enable_x64(True):
        problem, load = scale(problems)
        result = jax.device_get(solve(ScaledBatch(*map(jnp.asarray, problem)), jnp.asarray(load)))
    forces = load[:, None, None] * result.forces
    return problems.answer(forces, result.status, load**unit * result.objective, result.iterations)
