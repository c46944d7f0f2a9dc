"""Soft fingers and limited hands by Clarabel, one problem at a time, by any objective: an independent oracle.

Written as a second-order cone program with a quadratic objective, in the user's own coordinates; it shares nothing with
jaxgrasp.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.testing.references import tangents


class Case(NamedTuple):
    """Single problem in double precision; limits that are None do not exist."""

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


class ReferenceSolution(NamedTuple):
    """Clarabel's answer; arrays are NaN where it has none."""

    status: str
    forces: np.ndarray
    moments: np.ndarray
    objective: float


def optimum(case: Case, tolerance: float = 1e-12) -> ReferenceSolution:
    """Minimise the sum of |f - s a|^2 / 2k, moments over their levers included; return it with Clarabel's status.

    Contacts of weight zero hold their squeezing force.
    """
    n, body = len(case.friction), _body(case)
    adjustable = case.weights > 0
    cost = np.repeat(np.where(adjustable, 1 / np.where(adjustable, case.weights, 1), 0.0), 4)
    squeezing = np.zeros((n, 4))
    squeezing[:, 0] = case.squeeze
    fixed = [(i, c) for i in range(n) for c in range(4) if not adjustable[i] or (c == 3 and body.lever[i] == 0)]
    equal = np.zeros((len(fixed), 4 * n))
    equal[np.arange(len(fixed)), [4 * i + c for i, c in fixed]] = 1
    cones = _cones(case, body, 0)
    cones.insert(1, ("zero", equal, np.array([squeezing[i, c] for i, c in fixed])))
    status, x = _solve(np.diag(cost), -cost * squeezing.ravel(), cones, tolerance)
    objective = float(np.sum(cost.reshape(n, 4) * (x.reshape(n, 4) - squeezing) ** 2) / 2)
    return _to_solution(body, status, x, objective)


def least_maximal_force(case: Case, tolerance: float = 1e-11) -> ReferenceSolution:
    """Minimise the largest force of a contact [N], the moment over its lever included."""
    case, load = _in_units(case)
    n, body = len(case.friction), _body(case)
    cones = [*_cones(case, body, 1), _idle(body)]
    for i in range(n):
        rows = np.zeros((5, 4 * n + 1))
        rows[0, -1], rows[1:, 4 * i : 4 * i + 4] = -1, -np.eye(4)
        cones.append(("cone", rows, np.zeros(5)))
    status, x = _solve(np.zeros((4 * n + 1,) * 2), np.eye(4 * n + 1)[-1], cones, tolerance)
    return _to_solution(body, status, load * x[:-1], load * x[-1])


def least_torque(case: Case, tolerance: float = 1e-11) -> ReferenceSolution:
    """Minimise the Euclidean norm of the joint torques."""
    case, load = _in_units(case)
    n, body = len(case.friction), _body(case)
    torque_map = _torque_map(case, body).reshape(4 * n, -1)
    cones = [*_cones(case, body, 1), _idle(body)]
    rows = np.zeros((torque_map.shape[1] + 1, 4 * n + 1))
    rows[0, -1], rows[1:, :-1] = -1, -torque_map.T
    cones.append(("cone", rows, np.zeros(len(rows))))
    status, x = _solve(np.zeros((4 * n + 1,) * 2), np.eye(4 * n + 1)[-1], cones, tolerance)
    return _to_solution(body, status, load * x[:-1], load * x[-1])


def with_margin(case: Case, margin: float) -> str:
    """Return Clarabel's status for forces with no loaded contact with friction within ``margin`` [rad] of slipping."""
    case, _ = _in_units(case)
    angles = np.arctan(case.friction) - margin
    friction = np.where(case.friction > 0, np.tan(np.maximum(angles, 0)), 0)
    torsion = None
    if case.torsion is not None:
        torsion = case.torsion * np.where(
            case.friction > 0, friction / np.where(case.friction > 0, case.friction, 1), 0
        )
    most = np.full(len(friction), np.inf) if case.normal_max is None else case.normal_max
    most = np.where((case.friction > 0) & (angles < 0), 0, most)
    narrowed = case._replace(friction=friction, torsion=torsion, normal_max=most, squeeze=0 * case.squeeze)
    with np.errstate(over="ignore"):
        return optimum(narrowed, 1e-9).status


def wrench_margin(case: Case, direction: np.ndarray, tolerance: float = 1e-11) -> tuple[str, float]:
    """Return Clarabel's status and the largest t for which the forces can exert wrench + t direction."""
    case, load = _in_units(case)
    n, body = len(case.friction), _body(case)
    cones = [*_cones(case, body, 1), _idle(body)]
    cones[0][1][:, -1] = -direction
    status, x = _solve(np.zeros((4 * n + 1,) * 2), -np.eye(4 * n + 1)[-1], cones, tolerance)
    return status, float(load * x[-1])


def _in_units(case: Case) -> tuple[Case, float]:
    """Scale forces to units of the load, since Clarabel's tolerances are not relative; return the load [N] too."""
    load = float(np.linalg.norm(case.wrench[:3])) or 1.0
    named = {name: getattr(case, name) for name in ("squeeze", "wrench", "normal_min", "normal_max", "torque_max")}
    scaled: dict[str, Any] = {name: None if x is None else x / load for name, x in named.items()}
    return case._replace(**scaled), load


class _Body(NamedTuple):
    """Unknowns of a contact: normal force, two tangential ones, moment over its lever."""

    axes: np.ndarray
    """``(n, 3, 3)``; columns: normal, two tangents."""
    lever: np.ndarray
    maps: np.ndarray
    """Their wrenches ``(6, n, 4)``."""


def _body(case: Case) -> _Body:
    n = len(case.friction)
    axes = np.stack([np.stack([a, *tangents(a)], 1) for a in case.normals])
    torsion = np.zeros(n) if case.torsion is None else case.torsion
    lever = np.where(case.friction > 0, torsion / np.where(case.friction > 0, case.friction, 1), 0.0)
    maps = np.zeros((6, n, 4))
    for i in range(n):
        maps[:3, i, :3] = axes[i]
        maps[3:, i, :3] = np.cross(case.points[i], axes[i], axisb=0, axisc=0)
        maps[3:, i, 3] = lever[i] * case.normals[i]
    return _Body(axes, lever, maps)


Rows = tuple[str, np.ndarray, np.ndarray]


def _idle(body: _Body) -> Rows:
    """Constrain the moment unknowns of contacts without a lever to zero, in programs with one extra unknown."""
    idle = [4 * i + 3 for i in np.flatnonzero(body.lever == 0)]
    rows = np.zeros((len(idle), 4 * len(body.lever) + 1))
    rows[np.arange(len(idle)), idle] = 1
    return "zero", rows, np.zeros(len(idle))


def _cones(case: Case, body: _Body, extra: int) -> list[Rows]:
    """Return the rows of equilibrium, linear bounds and friction; ``extra`` unknowns follow those of the contacts."""
    n = len(case.friction)
    flat, bound = _bounds(case, body)
    cones = [("zero", body.maps.reshape(6, -1), case.wrench), ("linear", flat, bound)]
    for i in range(n):
        rows = np.zeros((4, 4 * n))
        rows[0, 4 * i], rows[1:, 4 * i + 1 : 4 * i + 4] = -case.friction[i], -np.eye(3)
        cones.append(("cone", rows, np.zeros(4)))
    return [(kind, np.pad(rows, [(0, 0), (0, extra)]), right) for kind, rows, right in cones]


def _solve(quadratic: np.ndarray, linear: np.ndarray, cones: list[Rows], tolerance: float) -> tuple[str, np.ndarray]:
    import clarabel
    from scipy import sparse

    kinds = {"zero": clarabel.ZeroConeT, "linear": clarabel.NonnegativeConeT, "cone": clarabel.SecondOrderConeT}
    cones = [entry for entry in cones if len(entry[2])]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix(quadratic),
        linear,
        sparse.csc_matrix(np.concatenate([rows for _, rows, _ in cones])),
        np.concatenate([right for _, _, right in cones]),
        [kinds[kind](len(right)) for kind, _, right in cones],
        settings,
    ).solve()
    return str(answer.status), np.asarray(answer.x)


def _to_solution(body: _Body, status: str, x: np.ndarray, objective: float) -> ReferenceSolution:
    x = x.reshape(-1, 4)
    return ReferenceSolution(
        status, np.einsum("nij,nj->ni", body.axes, x[:, :3]), body.lever * x[:, 3], float(objective)
    )


def _torque_map(case: Case, body: _Body) -> np.ndarray:
    """Compute the map ``(n, 4, j)`` from the unknowns to joint torques."""
    assert case.torque_map is not None
    torque_map = np.zeros((len(case.friction), 4, case.torque_map.shape[2]))
    torque_map[:, :3] = np.einsum("nki,nkj->nij", body.axes, case.torque_map[:, :3])
    if case.torque_map.shape[1] == 4:
        torque_map[:, 3] = body.lever[:, None] * case.torque_map[:, 3]
    return torque_map


def _bounds(case: Case, body: _Body) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and bounds of the linear constraints, on normal forces and torques."""
    n, rows, bounds = len(case.friction), [], []
    for sign, values in ((1, case.normal_max), (-1, case.normal_min)):
        if values is None:
            continue
        for i in range(n):
            if np.isfinite(values[i]):
                row = np.zeros((n, 4))
                row[i, 0] = sign
                rows.append(row.ravel())
                bounds.append(sign * values[i])
    if case.torque_map is not None and case.torque_max is not None:
        torque_map = _torque_map(case, body)
        for j in np.flatnonzero(np.isfinite(case.torque_max)):
            rows += [torque_map[:, :, j].ravel(), -torque_map[:, :, j].ravel()]
            bounds += [case.torque_max[j]] * 2
    return np.array(rows).reshape(len(rows), 4 * n), np.array(bounds)
