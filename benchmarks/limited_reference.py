"""The constrained optimum of soft fingers and limited hands by Clarabel, one problem at a time: an independent oracle.

Written as a second-order cone program with a quadratic objective, in the user's own coordinates; it shares nothing with
jaxgrasp.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.references import tangents


class Case(NamedTuple):
    """One problem, in double precision; what is None does not exist."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    wrench: np.ndarray
    weights: np.ndarray
    torsion: np.ndarray | None = None
    normal_min: np.ndarray | None = None
    normal_max: np.ndarray | None = None
    torque_map: np.ndarray | None = None
    """``(n, c, j)``."""
    torque_max: np.ndarray | None = None


class Found(NamedTuple):
    """Clarabel's answer; arrays are NaN where it has none."""

    status: str
    forces: np.ndarray
    moments: np.ndarray
    objective: float


def optimum(case: Case, tolerance: float = 1e-12) -> Found:
    """The optimum, and what Clarabel calls it; contacts of weight zero hold their squeezing force."""
    import clarabel
    from scipy import sparse

    n = len(case.friction)
    axes = np.stack([np.stack([a, *tangents(a)], 1) for a in case.normals])  # columns: normal, two tangents
    torsion = np.zeros(n) if case.torsion is None else case.torsion
    lever = np.where(case.friction > 0, torsion / np.where(case.friction > 0, case.friction, 1), 0.0)
    loose = case.weights > 0
    # Unknowns of a contact: normal force, two tangential ones, moment over its lever.
    maps = np.zeros((6, n, 4))
    for i in range(n):
        maps[:3, i, :3] = axes[i]
        maps[3:, i, :3] = np.cross(case.points[i], axes[i], axisb=0, axisc=0)
        maps[3:, i, 3] = lever[i] * case.normals[i]
    cost = np.repeat(np.where(loose, 1 / np.where(loose, case.weights, 1), 0.0), 4)
    wanted = np.zeros((n, 4))
    wanted[:, 0] = case.squeeze
    a, b, kinds = [maps.reshape(6, -1)], [case.wrench], [clarabel.ZeroConeT(6)]
    held = [(i, c) for i in range(n) for c in range(4) if not loose[i] or (c == 3 and lever[i] == 0)]
    if held:
        rows = np.zeros((len(held), 4 * n))
        rows[np.arange(len(held)), [4 * i + c for i, c in held]] = 1
        a, b = [*a, rows], [*b, np.array([wanted[i, c] for i, c in held])]
        kinds.append(clarabel.ZeroConeT(len(held)))
    flat, bound = _bounds(case, axes, lever)
    if len(bound):
        a, b = [*a, flat], [*b, bound]
        kinds.append(clarabel.NonnegativeConeT(len(bound)))
    for i in range(n):
        rows = np.zeros((4, 4 * n))
        rows[0, 4 * i], rows[1:, 4 * i + 1 : 4 * i + 4] = -case.friction[i], -np.eye(3)
        a, b = [*a, rows], [*b, np.zeros(4)]
        kinds.append(clarabel.SecondOrderConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.diag(cost)),
        -cost * wanted.ravel(),
        sparse.csc_matrix(np.concatenate(a)),
        np.concatenate(b),
        kinds,
        settings,
    )
    answer = solver.solve()
    x = np.asarray(answer.x).reshape(n, 4)
    objective = float(np.sum(cost.reshape(n, 4) * (x - wanted) ** 2) / 2)
    return Found(str(answer.status), np.einsum("nij,nj->ni", axes, x[:, :3]), lever * x[:, 3], objective)


def _bounds(case: Case, axes: np.ndarray, lever: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and bounds of what is linear: normal forces and torques."""
    n, rows, bounds = len(case.friction), [], []
    for sign, values in ((1, case.normal_max), (-1, case.normal_min)):
        for i in range(n) if values is not None else ():
            if np.isfinite(values[i]):
                row = np.zeros((n, 4))
                row[i, 0] = sign
                rows.append(row.ravel())
                bounds.append(sign * values[i])
    if case.torque_map is not None:
        asked = np.zeros((n, 4, case.torque_map.shape[2]))
        asked[:, :3] = np.einsum("nki,nkj->nij", axes, case.torque_map[:, :3])
        if case.torque_map.shape[1] == 4:
            asked[:, 3] = lever[:, None] * case.torque_map[:, 3]
        for j in np.flatnonzero(np.isfinite(case.torque_max)):
            rows += [asked[:, :, j].ravel(), -asked[:, :, j].ravel()]
            bounds += [case.torque_max[j]] * 2
    return np.array(rows).reshape(len(rows), 4 * n), np.array(bounds)
