"""Last resort for plain calls: undecided problems once more, by NumPy in extended precision on the host.

Where the dual's curvature spans more than ten orders of magnitude, as where friction of 1e-8 has to hold a torque, or
where a load lies within 1e-8 of the limit of what the contacts can exert, Newton's method in float64 stops short,
although float64 can hold the answer. Long double has three digits more. What is found is rounded to the data's
precision, judged there in long double, and only then believed: by balance and duality gap, or as a proof.

For circular cones and soft fingers, without guides and limits. Problems ``(B, n, ...)`` are solved together; c is 4
where fingers are soft, else 3.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.tolerances import tolerances

Wide = np.longdouble
MOST_STEPS = 200
LEAST_STEP = 2.0**-40
CONVERGED = 1e-17
"""Gradient of the dual over the sum of its terms at which Newton's method stops."""
STAGES = tuple(10.0**-k for k in range(0, 19, 2))
"""Weights of the forces' squares beside the square of the distance from the reachable wrenches, in turn."""
SHARES = (0.0, 0.3, 0.03)
"""Shares of that distance by which friction is widened, in turn."""


def is_available() -> bool:
    """Return whether this machine's long double is wider than float64."""
    return bool(np.finfo(Wide).eps < 1e-18)


class Scaled(NamedTuple):
    """Problems about the weighted centroid; lengths in weighted radii, forces in units of the load."""

    maps: np.ndarray
    """Wrench of each contact vector ``(B, n, 6, c)``; zero for contacts that cannot move."""
    normals: np.ndarray
    """``(B, n, c)``."""
    friction: np.ndarray
    squeeze: np.ndarray
    weights: np.ndarray
    """Of unit sum."""
    wrench: np.ndarray
    """What contacts that can move must exert ``(B, 6)``."""
    held: np.ndarray
    """Forces of the others ``(B, n, 3)`` [N]."""
    spin_radius: np.ndarray
    load: np.ndarray
    length: np.ndarray
    unit: np.ndarray
    """Sum of the weights."""
    centre: np.ndarray

    def take(self, lanes: np.ndarray) -> "Scaled":
        return Scaled(*(array[lanes] for array in self))

    def twist(self, scaled_twist: np.ndarray) -> np.ndarray:
        """Return twists about the frame's origin ``(B, 6)``."""
        angular = scaled_twist[:, 3:] / self.length[:, None]
        return np.concatenate([scaled_twist[:, :3] - np.cross(angular, self.centre), angular], -1)

    def scaled_twist(self, twist: np.ndarray) -> np.ndarray:
        """Return scaled components of twists about the frame's origin ``(B, 6)``."""
        linear = twist[:, :3] + np.cross(twist[:, 3:], self.centre)
        return np.concatenate([linear, twist[:, 3:] * self.length[:, None]], -1)


class Decided(NamedTuple):
    """New answers ``(B, ...)`` in the user's units, where ``verdict`` is not NOT_CONVERGED."""

    verdict: np.ndarray
    forces: np.ndarray
    moments: np.ndarray
    multiplier: np.ndarray
    objective: np.ndarray
    residual: np.ndarray
    certificate: np.ndarray
    force_bound: np.ndarray
    steps: np.ndarray


def supports(problem: ProblemBatch) -> bool:
    """Return whether the last resort can solve a batch: neither guides nor limits."""
    limits = (problem.free, problem.normal_min, problem.normal_max, problem.torque_bounds)
    return all(limit is None for limit in limits)


def decide(problem: ProblemBatch, lanes: np.ndarray) -> Decided:
    """Solve the problems at ``lanes`` of a batch whose arrays are NumPy's."""
    dtype = np.dtype(problem.wrench.dtype)
    scaled = _scale(problem, lanes)
    metric = _curvature(scaled, np.eye(scaled.maps.shape[-1], dtype=Wide), scaled.weights)
    # Directions that no contact can reach have no metric of their own.
    metric = metric + np.finfo(Wide).eps * np.einsum("bii->b", metric)[:, None, None] * np.eye(6, dtype=Wide)
    unknown, steps = _maximise(_dual, scaled, np.zeros((len(lanes), 6), Wide), metric)
    optimal, answer = _judged_optimum(scaled, unknown, dtype)
    verdict = np.where(optimal, Verdict.OPTIMAL, Verdict.NOT_CONVERGED)
    certificate, bound = np.zeros_like(unknown), np.zeros(len(lanes))
    left = np.flatnonzero(~optimal)
    if len(left):
        certificate[left], bound[left], proves = _proof(scaled.take(left), dtype)
        verdict[left[proves]] = Verdict.INFEASIBLE
    forces, moments, multiplier, objective, residual = answer
    return Decided(
        verdict, forces, moments, multiplier, objective, residual, certificate.astype(dtype), bound.astype(dtype), steps
    )


def patched(fields: dict[str, Any], lanes: np.ndarray, decided: Decided) -> dict[str, np.ndarray]:
    """Return the fields of a flat batch of solutions with the new answers at ``lanes``, where there are any."""
    new = decided.verdict != Verdict.NOT_CONVERGED
    rows, result = lanes[new], {}
    for name, array in fields.items():
        result[name] = array = np.array(array)
        if hasattr(decided, name):
            array[rows] = getattr(decided, name)[new]
        elif name == "route":
            array[rows] = Route.ROBUST
    return result


def _norm(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.sum(vectors**2, -1))


def _or_one(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, 1)


def _scale(problem: ProblemBatch, lanes: np.ndarray) -> Scaled:
    def rows(array: Any) -> np.ndarray:
        array = np.asarray(array)
        return np.asarray(np.broadcast_to(array, (problem.size, *array.shape[1:]))[lanes], Wide)

    points, normals, mu, s, k, wrench = (
        rows(getattr(problem, name)) for name in ("points", "normals", "friction", "squeeze", "weights", "wrench")
    )
    torsion = np.zeros_like(mu) if problem.torsion is None else rows(problem.torsion)
    if problem.present is not None:
        is_present = rows(problem.present) > 0.5
        points, normals = (np.where(is_present[..., None], x, 0) for x in (points, normals))
        mu, s, k, torsion = (np.where(is_present, x, 0) for x in (mu, s, k, torsion))
    normals = normals / _or_one(_norm(normals))[..., None]
    unit = _or_one(k.sum(-1))
    share = k / unit[:, None]
    centre = np.einsum("bn,bni->bi", share, points)
    arms = points - centre[:, None]
    length = np.sqrt(np.einsum("bn,bni->b", share, arms**2))
    length = np.where(length > 16 * np.finfo(Wide).eps * _norm(centre), length, _or_one(_norm(centre)))
    arms = arms / length[:, None, None]
    force = wrench[:, :3]
    about = (wrench[:, 3:] - np.cross(centre, force)) / length[:, None]
    load = _or_one(s.sum(-1) + _norm(force) + _norm(about))
    is_movable = k > 0
    held = np.where(is_movable, 0, s)[..., None] * normals
    resultant = np.concatenate([held.sum(1), np.cross(arms, held).sum(1)], -1)
    target = (np.concatenate([force, about], -1) - resultant) / load[:, None]
    radius = np.where(mu > 0, torsion / _or_one(mu), 0)
    columns = [np.concatenate([np.broadcast_to(e, arms.shape), np.cross(arms, e)], -1) for e in np.eye(3, dtype=Wide)]
    padded = normals
    if problem.torsion is not None:
        spin = (radius / length[:, None])[..., None] * normals
        columns.append(np.concatenate([0 * normals, spin], -1))
        padded = np.concatenate([normals, 0 * normals[..., :1]], -1)
    maps = np.stack(columns, -1) * is_movable[..., None, None]
    return Scaled(
        maps, padded, mu, s / load[:, None], share, target, held, radius, load, length, unit, centre
    )  # fmt: skip


def _project(
    u: np.ndarray, normals: np.ndarray, mu: np.ndarray, has_jacobian: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Project contact vectors ``(B, n, c)`` onto their cones; return also elements of the generalised Jacobians."""
    along = np.sum(u * normals, -1)
    across = u - along[..., None] * normals
    size = _norm(across)
    inside = size <= mu * along
    apex = ~inside & (mu * size <= -along)
    tangent = across / _or_one(size)[..., None]
    edge = normals + mu[..., None] * tangent
    height = (along + mu * size) / (1 + mu**2)
    projected = np.where(inside[..., None], u, np.where(apex[..., None], 0, height[..., None] * edge))
    if not has_jacobian:
        return projected, projected
    identity = np.eye(u.shape[-1], dtype=Wide)
    outer = normals[..., :, None] * normals[..., None, :] + tangent[..., :, None] * tangent[..., None, :]
    jacobian = edge[..., :, None] * edge[..., None, :] / (1 + mu**2)[..., None, None]
    jacobian = jacobian + (mu * height / _or_one(size))[..., None, None] * (identity - outer)
    jacobian = np.where(inside[..., None, None], identity, np.where(apex[..., None, None], 0, jacobian))
    return projected, jacobian


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve symmetric positive definite systems ``(B, 6, 6)`` by LDL', after scaling their diagonals to one."""
    diagonal = np.sqrt(_or_one(np.einsum("bii->bi", matrix)))
    factor = matrix / diagonal[:, :, None] / diagonal[:, None, :]
    x = right / diagonal
    size = x.shape[1]
    pivots = np.zeros_like(x)
    for j in range(size):
        pivots[:, j] = np.maximum(factor[:, j, j], np.finfo(Wide).eps)
        column = factor[:, j + 1 :, j] / pivots[:, j, None]
        factor[:, j + 1 :, j + 1 :] -= column[:, :, None] * factor[:, j, None, j + 1 :]
        factor[:, j + 1 :, j] = column
    for j in range(size):
        x[:, j + 1 :] -= factor[:, j + 1 :, j] * x[:, j, None]
    x = x / pivots
    for j in reversed(range(size)):
        x[:, :j] -= factor[:, j, :j] * x[:, j, None]
    return x / diagonal


def _contact_rates(scaled: Scaled, unknown: np.ndarray) -> np.ndarray:
    return np.matmul(unknown[:, None, None, :], scaled.maps)[:, :, 0]


def _exerted(scaled: Scaled, vectors: np.ndarray) -> np.ndarray:
    """Return the wrenches ``(B, 6)`` of contact vectors."""
    return np.matmul(scaled.maps, vectors[..., None])[..., 0].sum(1)


def _curvature(scaled: Scaled, jacobian: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the sum of factor_i G_i J_i G_i' ``(B, 6, 6)``."""
    weighted = np.matmul(scaled.maps * factor[..., None, None], jacobian)
    return np.matmul(weighted, np.swapaxes(scaled.maps, -1, -2)).sum(1)


class _Values(NamedTuple):
    """Concave functions of ``(B, 6)`` unknowns to be maximised."""

    value: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    """Minus the Hessians; zeros where they were not asked for."""
    vectors: np.ndarray


Function = Callable[[Scaled, np.ndarray, bool], _Values]


def _dual(scaled: Scaled, unknown: np.ndarray, has_curvature: bool = False) -> _Values:
    """Evaluate the duals: w.x + the sum of the least |f - s a|^2 / 2k - f.G'x over the cones."""
    rates = _contact_rates(scaled, unknown)
    is_movable = scaled.weights > 0
    start = scaled.squeeze[..., None] * scaled.normals
    target = start + scaled.weights[..., None] * rates
    vectors, jacobian = _project(target, scaled.normals, scaled.friction, has_curvature)
    vectors = np.where(is_movable[..., None], vectors, 0)
    deviation = np.where(is_movable[..., None], vectors - start, 0)
    cost = np.sum(deviation**2, -1) / (2 * _or_one(scaled.weights)) - np.sum(vectors * rates, -1)
    value = np.sum(scaled.wrench * unknown, -1) + cost.sum(-1)
    curvature = _curvature(scaled, jacobian, scaled.weights) if has_curvature else np.zeros((len(unknown), 6, 6), Wide)
    return _Values(value, scaled.wrench - _exerted(scaled, vectors), curvature, vectors)


def _distance(weight: float) -> Function:
    """Return the function w.d - |d|^2 / 2 - the sum of |projection of G'd|^2 / (2 weight)."""

    def evaluate(scaled: Scaled, d: np.ndarray, has_curvature: bool = False) -> _Values:
        best, jacobian = _project(_contact_rates(scaled, d), scaled.normals, scaled.friction, has_curvature)
        value = np.sum((scaled.wrench - d / 2) * d, -1) - np.sum(best * best, (-2, -1)) / (2 * weight)
        forces = best / weight
        curvature = np.zeros((len(d), 6, 6), Wide)
        if has_curvature:
            factor = np.full(scaled.weights.shape, 1 / Wide(weight))
            curvature = np.eye(6, dtype=Wide) + _curvature(scaled, jacobian, factor)
        return _Values(value, scaled.wrench - d - _exerted(scaled, forces), curvature, forces)

    return evaluate


def _maximise(
    function: Function, scaled: Scaled, unknown: np.ndarray, metric: np.ndarray | None = None, most: int = MOST_STEPS
) -> tuple[np.ndarray, np.ndarray]:
    """Maximise concave functions by Newton steps with a line search; return the unknowns ``(B, 6)`` and steps ``(B,)``.

    Args:
        function: its values, gradients and curvatures.
        scaled: the problems.
        unknown: where the search starts.
        metric: of Levenberg's damping ``(B, 6, 6)``; None for none.
        most: largest number of steps.
    """
    count = len(unknown)
    unknown, steps, damping = unknown.copy(), np.zeros(count, np.int32), np.full(count, Wide(1e-6))
    lanes = np.arange(count)
    for _ in range(most):
        part = scaled.take(lanes)
        here = function(part, unknown[lanes], True)
        error = _norm(here.gradient)
        # Contact vectors have the rounding of the multiplier, which may be 1e10 times as large.
        rounding = np.finfo(Wide).eps / 4 * _norm(unknown[lanes])
        is_open = error > CONVERGED * (_norm(part.wrench) + _norm(here.vectors).sum(-1)) + rounding
        if not is_open.any():
            break
        lanes, part = lanes[is_open], part.take(np.flatnonzero(is_open))
        here = _Values(*(x[is_open] for x in here))
        regular = here.curvature
        if metric is not None:
            regular = regular + np.minimum(damping[lanes], error[is_open])[:, None, None] * metric[lanes]
        direction = _solve(regular, here.gradient)
        length = _line_search(function, part, unknown[lanes], here, direction)
        damping[lanes] = np.where(length < 1, np.minimum(damping[lanes] * 10, 1), damping[lanes] / 100)
        unknown[lanes] += length[:, None] * direction
        steps[lanes] += 1
        lanes = lanes[length > 0]
        if not len(lanes):
            break
    return unknown, steps


def _line_search(
    function: Function, scaled: Scaled, start: np.ndarray, here: _Values, direction: np.ndarray
) -> np.ndarray:
    """Return the length of each step; 0 where none is found.

    Values are sums of large terms, whose rounding hides small gains: a step is taken, too, where the slope along it has
    fallen to half (Hager and Zhang's approximate Wolfe condition).
    """
    slope = np.sum(direction * here.gradient, -1)
    length, accepted = np.ones(len(start), Wide), np.zeros(len(start), bool)
    while not accepted.all():
        trial = function(scaled, start + length[:, None] * direction, False)
        gained = trial.value - here.value >= length * slope / 10000
        is_flat = np.abs(np.sum(trial.gradient * direction, -1)) <= slope / 2
        accepted = accepted | gained | is_flat | (length < LEAST_STEP)
        length = np.where(accepted, length, length / 2)
    return np.where(length < LEAST_STEP, 0, length)


def _balanced(scaled: Scaled, unknown: np.ndarray) -> np.ndarray:
    """Return the contact vectors of multipliers, with what rounding leaves of the wrench distributed over them.

    Multipliers may be 1e10 times as large as the forces. Newton's last steps are therefore added to the forces
    themselves, since forces that are computed from the multiplier anew have its rounding.
    """
    here = _dual(scaled, unknown, True)
    rates = _contact_rates(scaled, unknown)
    target = scaled.squeeze[..., None] * scaled.normals + scaled.weights[..., None] * rates
    jacobian = _project(target, scaled.normals, scaled.friction, True)[1]
    vectors = here.vectors
    for _ in range(4):
        step = _solve(here.curvature, scaled.wrench - _exerted(scaled, vectors))
        moved = scaled.weights[..., None] * np.matmul(jacobian, _contact_rates(scaled, step)[..., None])[..., 0]
        trial = _project(vectors + moved, scaled.normals, scaled.friction)[0]
        trial = np.where((scaled.weights > 0)[..., None], trial, 0)
        is_better = _norm(scaled.wrench - _exerted(scaled, trial)) < _norm(scaled.wrench - _exerted(scaled, vectors))
        vectors = np.where(is_better[:, None, None], trial, vectors)
    return vectors


def _judged_optimum(scaled: Scaled, unknown: np.ndarray, dtype: np.dtype) -> tuple[np.ndarray, tuple]:
    """Round the answers to the data's precision and judge them there; return a mask, and the fields of ``Decided``."""
    tol = tolerances(dtype)
    vectors = _balanced(scaled, unknown)
    forces = (scaled.load[:, None, None] * vectors[..., :3] + scaled.held).astype(dtype)
    is_soft = vectors.shape[-1] == 4
    moments = np.zeros(forces.shape[:2], dtype)
    if is_soft:
        moments = (scaled.load[:, None] * scaled.spin_radius * vectors[..., 3]).astype(dtype)
    factor = (scaled.load / scaled.unit)[:, None]
    multiplier = (scaled.twist(unknown) * factor).astype(dtype)
    # Back from what was rounded.
    rounded = np.asarray(forces - scaled.held.astype(dtype), Wide) / scaled.load[:, None, None]
    if is_soft:
        spin = np.where(scaled.spin_radius > 0, moments / _or_one(scaled.spin_radius), 0) / scaled.load[:, None]
        rounded = np.concatenate([rounded, spin[..., None]], -1)
    rounded = np.where((scaled.weights > 0)[..., None], rounded, 0)
    dual_value = _dual(scaled, scaled.scaled_twist(np.asarray(multiplier, Wide)) / factor).value
    residual = _norm(scaled.wrench - _exerted(scaled, rounded))
    sizes = np.sum(np.sqrt(np.sum(scaled.maps**2, (-2, -1))) * _norm(rounded), -1)
    relative = residual / _or_one(np.maximum(_norm(scaled.wrench), tol.sums / tol.balance * sizes))
    deviation = np.where((scaled.weights > 0)[..., None], rounded - scaled.squeeze[..., None] * scaled.normals, 0)
    halves = 2 * _or_one(scaled.weights)
    primal = np.sum(np.sum(deviation**2, -1) / halves, -1)
    idle = np.sum(np.where(scaled.weights > 0, scaled.squeeze**2 / halves, 0), -1)
    gap = np.abs(primal - dual_value) / _or_one(np.maximum(primal, idle))
    nearest = _project(rounded, scaled.normals, scaled.friction)[0]
    outside = _norm(rounded - nearest).max(-1) / _or_one(_norm(rounded).max(-1))
    good = (relative <= tol.balance) & (gap <= tol.gap) & (outside <= 8 * np.finfo(dtype).eps)
    finite = np.isfinite(forces).all((1, 2)) & np.isfinite(multiplier).all(-1)
    objective = (factor[:, 0] * scaled.load * primal).astype(dtype)
    return good & finite, (forces, moments, multiplier, objective, relative.astype(dtype))


def _proof(scaled: Scaled, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return twists about the frame's origin, the total forces [N] that they prove to be needed, and whether enough.

    The wrench less the nearest reachable one is the proof. A weight on the forces' squares leaves each contact able to
    do a little work along it; so it is computed once more for friction wider by a share of that distance.
    """
    d = scaled.wrench.copy()
    best_twist, best_bound = np.zeros_like(d), np.zeros(len(d), Wide)
    for share in SHARES:
        wider = scaled._replace(friction=scaled.friction * (1 + share * _norm(d)[:, None])) if share else scaled
        for weight in STAGES if share == 0 else STAGES[-3:]:
            d, _ = _maximise(_distance(weight), wider, d, most=30)
            for direction in (d, _without_rates(wider, d, weight)):
                twist, bound = _judged_proof(scaled, direction, dtype)
                is_better = bound > best_bound
                best_twist = np.where(is_better[:, None], twist, best_twist)
                best_bound = np.where(is_better, bound, best_bound)
    proves = best_bound >= tolerances(dtype).proof
    force_bound = np.minimum(best_bound * scaled.load, np.finfo(dtype).max)
    return best_twist, np.where(proves, force_bound, 0), proves


def _without_rates(scaled: Scaled, d: np.ndarray, weight: float) -> np.ndarray:
    """Return directions along which contacts do not move whose forces lie inside their cones."""
    rates = _contact_rates(scaled, d)
    along = np.sum(rates * scaled.normals, -1)
    across = _norm(rates - along[..., None] * scaled.normals)
    is_inside = across < scaled.friction * along
    rows = np.swapaxes(scaled.maps * is_inside[..., None, None], -1, -2).reshape(len(d), -1, 6)
    inverse = np.linalg.pinv(np.asarray(rows, float), rcond=1e-9)
    result = d.copy()
    for _ in range(3):
        result = result - np.matmul(inverse, np.matmul(rows, result[..., None]))[..., 0]
    return result


def _judged_proof(scaled: Scaled, d: np.ndarray, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return twists rounded to the data's precision, and the total normal forces, in loads, that they prove needed."""
    size = _norm(d)
    twist = scaled.twist(d / _or_one(size)[:, None])
    twist = (twist / _or_one(np.abs(twist).max(-1))[:, None]).astype(dtype)
    rounded = scaled.scaled_twist(np.asarray(twist, Wide))
    rates = _contact_rates(scaled, rounded)
    along = np.sum(rates * scaled.normals, -1)
    support = along + scaled.friction * _norm(rates - along[..., None] * scaled.normals)
    most = np.max(np.where(scaled.weights > 0, support, -np.inf), -1)
    work = np.sum(scaled.wrench * rounded, -1)
    largest = float(np.finfo(dtype).max) / 1e8
    with np.errstate(divide="ignore", over="ignore"):
        bound = np.where(most > 0, np.minimum(work / np.where(most > 0, most, 1), largest), largest)
    return twist, np.where(work > 0, bound, 0)
