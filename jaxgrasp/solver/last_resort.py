"""Last resort for plain calls: undecided problems once more, by NumPy in extended precision on the host.

Where the dual's curvature spans more than ten orders of magnitude, as where friction of 1e-8 has to hold a torque, or
where a load lies within 1e-8 of the limit of what the contacts can exert, Newton's method in float64 stops short,
although float64 can hold the answer. Long double has three digits more. What is found is rounded to the data's
precision, judged there in long double, and only then believed: by balance and duality gap, or as a proof.

For circular cones and soft fingers, without guides and limits. Problems ``(B, n, ...)`` are solved together; c is 4
where fingers are soft, else 3.
"""

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
    unknown, steps = _maximise(scaled)
    optimal, answer = _judged_optimum(scaled, unknown, dtype)
    verdict = np.where(optimal, Verdict.OPTIMAL, Verdict.NOT_CONVERGED)
    certificate, bound = np.zeros_like(unknown), np.zeros(len(lanes))
    left = np.flatnonzero(~optimal)
    if len(left):
        certificate[left], bound[left], proves = _proof(scaled.take(left), dtype)
        verdict[left[proves]] = Verdict.INFEASIBLE
    return Decided(verdict, *answer, certificate.astype(dtype), bound.astype(dtype), steps)


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


def _project(u: np.ndarray, normals: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Project contact vectors ``(B, n, c)`` onto their cones; return also elements of the generalised Jacobians."""
    along = np.sum(u * normals, -1)
    across = u - along[..., None] * normals
    size = _norm(across)
    inside = size <= mu * along
    apex = ~inside & (mu * size <= -along)
    tangent = across / _or_one(size)[..., None]
    edge = normals + mu[..., None] * tangent
    height = (along + mu * size) / (1 + mu**2)
    identity = np.eye(u.shape[-1], dtype=Wide)
    outer = normals[..., :, None] * normals[..., None, :] + tangent[..., :, None] * tangent[..., None, :]
    jacobian = edge[..., :, None] * edge[..., None, :] / (1 + mu**2)[..., None, None]
    jacobian = jacobian + (mu * height / _or_one(size))[..., None, None] * (identity - outer)
    jacobian = np.where(inside[..., None, None], identity, np.where(apex[..., None, None], 0, jacobian))
    return np.where(inside[..., None], u, np.where(apex[..., None], 0, height[..., None] * edge)), jacobian


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
    return np.einsum("bnij,bi->bnj", scaled.maps, unknown)


def _dual(scaled: Scaled, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the dual's values, gradients, minus its Hessians, and the contact vectors."""
    rates = _contact_rates(scaled, unknown)
    is_movable, weights = scaled.weights > 0, scaled.weights[..., None]
    start = scaled.squeeze[..., None] * scaled.normals
    vectors, jacobian = _project(start + weights * rates, scaled.normals, scaled.friction)
    vectors = np.where(is_movable[..., None], vectors, 0)
    deviation = np.where(is_movable[..., None], vectors - start, 0)
    cost = np.sum(deviation**2, -1) / (2 * _or_one(scaled.weights)) - np.sum(vectors * rates, -1)
    value = np.sum(scaled.wrench * unknown, -1) + cost.sum(-1)
    gradient = scaled.wrench - np.einsum("bnij,bnj->bi", scaled.maps, vectors)
    weighted = scaled.maps * weights[..., None]
    hessian = np.einsum("bnij,bnjk,bnlk->bil", weighted, jacobian, scaled.maps)
    return value, gradient, hessian, vectors


def _maximise(scaled: Scaled) -> tuple[np.ndarray, np.ndarray]:
    """Maximise the duals by damped Newton steps with a line search; return multipliers and steps."""
    count = len(scaled.wrench)
    unknown, steps = np.zeros((count, 6), Wide), np.zeros(count, np.int32)
    damping = np.full(count, Wide(1e-6))
    metric = np.einsum("bn,bnij,bnlj->bil", scaled.weights, scaled.maps, scaled.maps)
    metric = metric + np.finfo(Wide).eps * np.einsum("bii->b", metric)[:, None, None] * np.eye(6, dtype=Wide)
    lanes = np.arange(count)
    for _ in range(MOST_STEPS):
        part = scaled.take(lanes)
        value, gradient, hessian, vectors = _dual(part, unknown[lanes])
        error = _norm(gradient)
        terms = _norm(part.wrench) + _norm(vectors).sum(-1)
        is_open = error > CONVERGED * terms
        if not is_open.any():
            break
        lanes, part = lanes[is_open], part.take(np.flatnonzero(is_open))
        value, gradient, hessian, error = (x[is_open] for x in (value, gradient, hessian, error))
        strength = np.minimum(damping[lanes], error)
        direction = _solve(hessian + strength[:, None, None] * metric[lanes], gradient)
        slope = np.sum(direction * gradient, -1)
        length, accepted = np.ones(len(lanes), Wide), np.zeros(len(lanes), bool)
        # Values are sums of large terms, whose rounding hides small gains.
        rounding = 16 * np.finfo(Wide).eps * (1 + np.abs(value))
        while not accepted.all():
            trial = unknown[lanes] + length[:, None] * direction
            accepted = accepted | (_dual(part, trial)[0] >= value + length * slope / 10000 - rounding)
            accepted = accepted | (length < LEAST_STEP)
            length = np.where(accepted, length, length / 2)
        damping[lanes] = np.where(length < 1, np.minimum(damping[lanes] * 10, 1), damping[lanes] / 100)
        unknown[lanes] += length[:, None] * direction
        steps[lanes] += 1
    return unknown, steps


def _judged_optimum(scaled: Scaled, unknown: np.ndarray, dtype: np.dtype) -> tuple[np.ndarray, tuple]:
    """Round the answers to the data's precision and judge them there; return a mask, and the fields of ``Decided``."""
    tol = tolerances(dtype)
    vectors = _dual(scaled, unknown)[3]
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
    dual_value = _dual(scaled, scaled.scaled_twist(np.asarray(multiplier, Wide)) / factor)[0]
    residual = _norm(scaled.wrench - np.einsum("bnij,bnj->bi", scaled.maps, rounded))
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
    """Return twists about the frame's origin, the total forces [N] that they prove to be needed, and whether enough."""
    wrench, identity = scaled.wrench, np.eye(6, dtype=Wide)
    d = wrench.copy()

    def evaluate(d: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate w.d - |d|^2 / 2 - the sum of |projection of G_i' d|^2 / (2 weight), its gradient and curvature."""
        best, jacobian = _project(_contact_rates(scaled, d), scaled.normals, scaled.friction)
        value = np.sum(wrench * d, -1) - np.sum(d * d, -1) / 2 - np.sum(best * best, (-2, -1)) / (2 * weight)
        gradient = wrench - d - np.einsum("bnij,bnj->bi", scaled.maps, best) / weight
        hessian = np.einsum("bnij,bnjk,bnlk->bil", scaled.maps, jacobian, scaled.maps) / weight
        return value, gradient, hessian + identity

    best_twist, best_bound = np.zeros_like(d), np.zeros(len(d), Wide)
    for weight in STAGES:
        for _ in range(30):
            value, gradient, hessian = evaluate(d, weight)
            direction = _solve(hessian, gradient)
            slope, length = np.sum(direction * gradient, -1), np.ones(len(d), Wide)
            if (slope <= np.finfo(Wide).eps * np.abs(value)).all():
                break
            accepted = np.zeros(len(d), bool)
            while not accepted.all():
                gained = evaluate(d + length[:, None] * direction, weight)[0] - value
                accepted = accepted | (gained >= length * slope / 10000) | (length < LEAST_STEP)
                length = np.where(accepted, length, length / 2)
            d = d + np.where(length < LEAST_STEP, 0, length)[:, None] * direction
        twist, bound = _judged_proof(scaled, d, dtype)
        is_better = bound > best_bound
        best_twist, best_bound = np.where(is_better[:, None], twist, best_twist), np.where(is_better, bound, best_bound)
    proves = best_bound >= tolerances(dtype).proof
    return best_twist, np.where(proves, best_bound * scaled.load, 0), proves


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
