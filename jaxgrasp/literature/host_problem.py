"""One problem brought to order one, as the methods that run on the host solve it, and the loop over a batch of them.

Lengths in units of the contacts' radius about their centroid, forces in units of the load; absent contacts left out.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.literature.method_input import MethodInput
from jaxgrasp.literature.scaled_batch import ScaledBatch, scale
from jaxgrasp.numerics.centring import tangents

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


def host_problem(given: MethodInput, scaled: ScaledBatch, load: float, index: int) -> HostProblem:
    """One problem of the batch, with at least one contact."""
    there = np.flatnonzero(given.present[index])
    normals = scaled.normals[index, there]
    return HostProblem(
        there=there,
        balance=_grasp_matrix(scaled.arms[index, there]),
        wrench=scaled.wrench[index],
        normals=normals,
        tangents=np.stack(tangents(normals, np), 1),
        friction=given.friction[index, there],
        squeeze=given.squeeze[index, there] / load,
        normal_min=given.normal_min[index, there] / load,
        normal_max=given.normal_max[index, there] / load,
        torque_rows=given.torque_map[index, there].reshape(3 * len(there), -1).T,
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
    scaled, loads = scale(given)
    for index in np.flatnonzero(given.valid).tolist():
        if not given.present[index].any():
            # Nothing balances nothing.
            status[index] = MethodStatus.INFEASIBLE if given.wrench[index].any() else MethodStatus.SOLVED
            continue
        problem = host_problem(given, scaled, float(loads[index]), index)
        found = solve(problem)
        status[index], objective[index], iterations[index] = found.status, found.objective, found.iterations
        if found.forces is not None:
            forces[index, problem.there] = problem.load * found.forces.reshape(-1, 3)
    return given.answer(forces, status, objective, iterations)
