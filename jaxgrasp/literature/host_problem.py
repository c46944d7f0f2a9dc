"""One problem brought to order one, as the methods that run on the host solve it, and the loop over a batch of them.

Lengths in units of the contacts' radius about their centroid, forces in units of the load; absent contacts left out.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.literature.method_input import MethodInput

RANK_CUT = 1e-11
"""Singular values of the scaled grasp matrix below this share of the largest count as zero."""
REACH = 1e-9
"""Part of a wrench that forces may leave unbalanced, relative to it, before it counts as out of reach."""


class HostProblem(NamedTuple):
    """One problem of m contacts; force vectors are flat ``(3m,)``, contact after contact."""

    there: np.ndarray
    """Which of the caller's contacts these are ``(m,)``."""
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
    """[N]: squeezing forces, force, and torque over the radius."""


class Balance(NamedTuple):
    """All forces that give the wrench: ``particular + basis z``."""

    particular: np.ndarray
    """Those of least norm ``(3m,)``: the pseudo-inverse part."""
    basis: np.ndarray
    """Orthonormal internal forces ``(3m, 3m - rank)``."""
    inverse: np.ndarray
    """The pseudo-inverse of the grasp matrix ``(3m, 6)``."""
    reached: bool
    """Whether any forces, allowed or not, give the wrench."""


class HostResult(NamedTuple):
    """What a method finds for one problem; ``forces`` in units of the load, None where there are none."""

    status: MethodStatus
    forces: np.ndarray | None = None
    objective: float = 0.0
    iterations: int = 0


def host_problem(given: MethodInput, index: int) -> HostProblem:
    """One problem of the batch, with at least one contact."""
    there = np.flatnonzero(given.present[index])
    points, normals = given.points[index, there], given.normals[index, there]
    squeeze = given.squeeze[index, there]
    centre = points.mean(0)
    arms = points - centre
    length = float(np.sqrt(np.mean(np.sum(arms**2, -1))))
    # Contacts in one point, but for rounding of the mean, have no length of their own.
    if length <= 16 * np.finfo(float).eps * np.linalg.norm(centre):
        length = float(np.linalg.norm(centre)) or 1.0
    force = given.wrench[index, :3]
    torque = (given.wrench[index, 3:] - np.cross(centre, force)) / length
    load = float(squeeze.sum() + np.linalg.norm(force) + np.linalg.norm(torque)) or 1.0
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    first = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), -1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    rows = given.torque_map[index, there].reshape(3 * len(there), -1).T
    return HostProblem(
        there=there,
        balance=_grasp_matrix(arms / length),
        wrench=np.concatenate([force, torque]) / load,
        normals=normals,
        tangents=np.stack([first, np.cross(normals, first)], 1),
        friction=given.friction[index, there],
        squeeze=squeeze / load,
        normal_min=given.normal_min[index, there] / load,
        normal_max=given.normal_max[index, there] / load,
        torque_rows=rows,
        torque_max=given.torque_max[index] / load,
        load=load,
    )


def _grasp_matrix(arms: np.ndarray) -> np.ndarray:
    """``(6, 3m)``: column 3i + j belongs to component j of force i."""
    units = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
    torques = np.cross(arms[:, None], units)
    return np.concatenate([units, torques], -1).reshape(-1, 6).T


def balanced(problem: HostProblem) -> Balance:
    """The general solution of G f = w, by a singular value decomposition."""
    left, sizes, right = np.linalg.svd(problem.balance, full_matrices=True)
    rank = int(np.sum(sizes > RANK_CUT * sizes[0]))
    inverse = right[:rank].T @ (left[:, :rank] / sizes[:rank]).T
    particular = inverse @ problem.wrench
    rest = problem.wrench - problem.balance @ particular
    # Once more, so that the wrench is balanced to rounding however close to a line the contacts are.
    particular = particular + inverse @ rest
    rest = np.linalg.norm(problem.wrench - problem.balance @ particular)
    # The load is one, so that a wrench of a few roundings is none.
    reached = bool(rest <= max(REACH * np.linalg.norm(problem.wrench), 64 * np.finfo(float).eps))
    return Balance(particular, right[rank:].T, inverse, reached)


def solve_each(given: MethodInput, solve: Callable[[HostProblem], HostResult]) -> MethodAnswer:
    """One problem after the other, on the host."""
    count, n = given.friction.shape
    forces, objective = np.zeros((count, n, 3)), np.zeros(count)
    status, iterations = np.zeros(count, int), np.zeros(count, int)
    for index in np.flatnonzero(given.valid).tolist():
        if not given.present[index].any():
            # Nothing balances nothing.
            status[index] = MethodStatus.INFEASIBLE if given.wrench[index].any() else MethodStatus.SOLVED
            continue
        problem = host_problem(given, index)
        found = solve(problem)
        status[index], objective[index], iterations[index] = found.status, found.objective, found.iterations
        if found.forces is not None:
            forces[index, problem.there] = problem.load * found.forces.reshape(-1, 3)
    return given.answer(forces, status, objective, iterations)
