"""Reference answers of the suite, by mpmath in 80 digits: optima, certificates and limits of what a grasp can exert.

Nothing here imports the solver. Each problem is solved on its dual, from a multiplier of zero, by Newton's method with
a line search and Levenberg's damping; ``jaxgrasp.testing.suite_judge`` checks the results in other arithmetic, Python's
``decimal`` and ``fractions``. ``benchmarks.make_suite`` writes the results into the package.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import mpmath
import numpy as np
from mpmath import mpf

from jaxgrasp.testing.suite_problem import SuiteProblem
from jaxgrasp.testing.suite_program import conic_program
from jaxgrasp.testing.suite_solvers import SOLVERS

DIGITS = 80
CONVERGED = mpf("1e-45")
"""Gradient of the dual, relative to the load, at which Newton's method stops."""
WIDENED = mpf("1e-13")
"""Widening of the friction for which a certificate is computed, so that rounding it cannot spoil it."""
ESCAPE = mpf("1e-20")
ZERO = mpf(0)

Array = np.ndarray
"""Of numbers of mpmath, dtype object."""


class NotDecidedError(Exception):
    """Newton's method did not converge."""


class Scaled(NamedTuple):
    """A problem about the weighted centroid; lengths in weighted radii, forces in units of the load."""

    maps: list[Array]
    """Of each contact that can move: wrench of its contact vector ``(6, c)``; c is 4 for a soft finger."""
    normals: list[Array]
    """Unit normals, padded with zero for the spin component ``(c,)``."""
    friction: list[mpf]
    squeeze: list[mpf]
    weights: list[mpf]
    wrench: Array
    """What the contacts that can move must exert ``(6,)``."""
    torque_rows: Array
    """Torques of the joints by the contact vectors, ``(joints, total of c)``."""
    torque_max: Array
    movable: list[int]
    spin_radius: list[mpf]
    load: mpf
    length: mpf
    unit: mpf
    centre: Array


class Optimum(NamedTuple):
    """Solution in the user's units."""

    forces: Array
    moments: Array
    multiplier: Array
    torque_multiplier: Array
    hessian_condition: float
    """Ratio of the largest to the smallest nonzero eigenvalue of the dual's Hessian in whitened coordinates."""
    steps: int


def exact(values: Any) -> Array:
    """Convert floats to numbers of mpmath without rounding."""
    values = np.asarray(values, float)
    return np.array([mpf(float(x)) for x in values.ravel()], dtype=object).reshape(values.shape)


def pair(values: Array) -> np.ndarray:
    """Split numbers of mpmath into float64 pairs ``(2, ...)`` whose sum has 31 digits."""
    with mpmath.workdps(DIGITS):
        values = np.asarray(values, dtype=object)
        high = np.array([float(x) for x in values.ravel()]).reshape(values.shape)
        low = np.array([float(x - float(x)) for x in values.ravel()]).reshape(values.shape)
    return np.stack([high, low])


def cross(a: Sequence, b: Sequence) -> Array:
    """Return the cross product of two vectors of mpmath's numbers."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]], dtype=object)


def norm(vector: Array) -> mpf:
    """Return the Euclidean length."""
    return mpmath.sqrt(sum((x * x for x in vector), mpf(0)))


def scale(problem: SuiteProblem, widened: mpf = ZERO) -> Scaled:
    """Scale a problem; ``widened`` is added to each friction coefficient, in parts of it."""
    points, wrench = exact(problem.points), exact(problem.wrench)
    normals = [a / norm(a) for a in exact(problem.normals)]
    mu, s, k = (exact(x) for x in (problem.friction, problem.squeeze, problem.weights))
    gamma = exact(problem.torsion) if problem.torsion is not None else exact(np.zeros(len(mu)))
    total = sum(k)
    centre = sum(k[:, None] * points) / total
    arms = points - centre
    length = mpmath.sqrt(sum(k * np.array([a @ a for a in arms])) / total)
    if length < mpf("1e-30") * (1 + norm(centre)):
        length = norm(centre) if norm(centre) > 0 else mpf(1)
    force = wrench[:3]
    about = (wrench[3:] - cross(centre, force)) / length
    load = sum(s) + norm(force) + norm(about)
    load = load if load > 0 else mpf(1)
    movable = [i for i in range(len(mu)) if k[i] > 0]
    target = np.concatenate([force, about]) / load
    for i in (i for i in range(len(mu)) if k[i] == 0):
        held = s[i] * normals[i] / load
        target = target - np.concatenate([held, cross(arms[i] / length, held)])
    rows = exact(np.zeros((0, 0)))
    most = exact(np.zeros(0))
    maps, padded, spins = [], [], []
    for i in movable:
        spin = gamma[i] / mu[i] if mu[i] > 0 else mpf(0)
        columns = [np.concatenate([e, cross(arms[i] / length, e)]) for e in exact(np.eye(3))]
        if spin > 0:
            columns.append(np.concatenate([0 * normals[i], spin / length * normals[i]]))
        maps.append(np.stack(columns, 1))
        padded.append(np.concatenate([normals[i], [mpf(0)]]) if spin > 0 else normals[i])
        spins.append(spin)
    if problem.torque_map is not None and problem.torque_max is not None:
        # Hard fingers alone have torque limits in the suite.
        rows = np.concatenate([exact(problem.torque_map[i]).T for i in movable], 1)
        most = exact(problem.torque_max) / load
    friction = [mu[i] * (1 + widened) for i in movable]
    return Scaled(
        maps, padded, friction, [s[i] / load for i in movable], [k[i] / total for i in movable], target, rows, most,
        movable, spins, load, length, total, centre,
    )  # fmt: skip


def project(u: Array, normal: Array, mu: mpf, derivative: bool = True) -> tuple[Array, Array | None]:
    """Project a contact vector onto its cone; return the projection and an element of its generalised Jacobian."""
    along = u @ normal
    across = u - along * normal
    size = norm(across)
    identity = exact(np.eye(len(u))) if derivative else None
    if size <= mu * along:
        return u, identity
    if mu * size <= -along:
        return 0 * u, 0 * identity if derivative else None
    if mu == 0:
        return along * normal, np.outer(normal, normal)
    tangent = across / size
    edge = normal + mu * tangent
    height = (along + mu * size) / (1 + mu * mu)
    if not derivative:
        return height * edge, None
    tangents = identity - np.outer(normal, normal) - np.outer(tangent, tangent)
    return height * edge, np.outer(edge, edge) / (1 + mu * mu) + (mu * height / size) * tangents


def solve_linear(matrix: Array, right: Array) -> Array:
    """Solve a linear system by mpmath's LU factorisation."""
    solution = mpmath.lu_solve(mpmath.matrix(matrix.tolist()), mpmath.matrix(right.tolist()))
    return np.array(list(solution), dtype=object)


class _Dual:
    """The dual function of a scaled problem, for the torque limits that are active with their signs."""

    def __init__(self, scaled: Scaled, active: dict[int, int]) -> None:
        self.scaled = scaled
        self.active = active
        rows = [sign * scaled.torque_rows[j] for j, sign in active.items()]
        sizes = np.cumsum([0, *(m.shape[1] for m in scaled.maps)])
        self.maps = []
        for i, grasp_map in enumerate(scaled.maps):
            torque = [-row[sizes[i] : sizes[i + 1]] for row in rows]
            self.maps.append(
                np.concatenate([grasp_map, np.array(torque, dtype=object).reshape(-1, grasp_map.shape[1])])
            )
        self.right = np.concatenate([scaled.wrench, [-scaled.torque_max[j] for j in active]])
        self.metric = sum(k * m @ m.T for k, m in zip(scaled.weights, self.maps, strict=True))

    def evaluate(self, unknown: Array, derivative: bool = True) -> tuple[mpf, Array, Array | None, list[Array]]:
        """Return the dual's value, its gradient, minus its Hessian, and the contact vectors."""
        scaled = self.scaled
        value, gradient = self.right @ unknown, self.right.copy()
        hessian = 0 * self.metric if derivative else None
        vectors = []
        data = zip(self.maps, scaled.normals, scaled.friction, scaled.squeeze, scaled.weights, strict=True)
        for grasp_map, normal, mu, s, k in data:
            u = s * normal + k * (grasp_map.T @ unknown)
            best, jacobian = project(u, normal, mu, derivative)
            deviation = best - s * normal
            value += deviation @ deviation / (2 * k) - (best @ (grasp_map.T @ unknown))
            gradient = gradient - grasp_map @ best
            if derivative:
                hessian = hessian + k * (grasp_map @ jacobian @ grasp_map.T)
            vectors.append(best)
        return value, gradient, hessian, vectors

    def maximise(self, unknown: Array, most_steps: int = 200) -> tuple[Array, list[Array], Array, int]:
        """Maximise by damped Newton steps; return the multiplier, contact vectors, minus the Hessian, and steps."""
        damping = mpf("1e-6")
        identity = exact(np.eye(len(unknown)))
        scale_of_metric = sum(self.metric[i, i] for i in range(len(unknown)))
        value, gradient, hessian, vectors = self.evaluate(unknown)
        for step in range(most_steps):
            error = norm(gradient)
            if error < CONVERGED:
                return unknown, vectors, hessian, step
            regular = hessian + min(damping, error) * self.metric + mpf("1e-70") * scale_of_metric * identity
            direction = solve_linear(regular, gradient)
            slope = direction @ gradient
            length, accepted = mpf(1), False
            for _ in range(60):
                trial = unknown + length * direction
                new_value, *_ = self.evaluate(trial, derivative=False)
                # Near the optimum the rounding of 80 digits hides what a step gains.
                if new_value >= value + length * slope / 10000 - mpf("1e-70") * (1 + abs(value)):
                    accepted = True
                    break
                length /= 2
            if not accepted:
                raise NotDecidedError(f"the line search failed at a gradient of {mpmath.nstr(error, 3)}")
            damping = min(damping * 10, mpf(1)) if length < 1 else damping / 100
            unknown = trial
            value, gradient, hessian, vectors = self.evaluate(unknown)
        raise NotDecidedError(f"gradient of {mpmath.nstr(error, 3)} after {most_steps} steps")


def optimum(problem: SuiteProblem) -> Optimum:
    """Return the optimum of a feasible problem.

    Newton's method starts from a multiplier of zero, and where it does not converge from Clarabel's. The start does not
    matter, since the result is judged.

    Raises:
        NotDecidedError: where Newton's method does not converge, as where no forces exist.
    """
    with mpmath.workdps(DIGITS):
        try:
            return _optimum(problem, exact(np.zeros(6)), {})
        except NotDecidedError:
            return _optimum(problem, *_start_of_clarabel(problem))


def _start_of_clarabel(problem: SuiteProblem) -> tuple[Array, dict[int, int]]:
    """Return a multiplier and the active torque limits with their signs."""
    program = conic_program(problem, is_scaled=True)
    answer = SOLVERS["clarabel"].solve_program(program, 1e-10, True)
    assert answer.z is not None
    joints = 0 if problem.torque_max is None else len(problem.torque_max)
    rows = answer.z[: program.n_zero + program.n_nonnegative][-2 * joints :] if joints else np.zeros(0)
    least = 1e-6 * np.abs(answer.z).max()
    active = {int(row % joints): 1 if row < joints else -1 for row in np.flatnonzero(rows > least)}
    return exact(np.concatenate([-answer.z[:6], np.zeros(len(active))])), active


def _optimum(problem: SuiteProblem, start: Array, active: dict[int, int]) -> Optimum:
    with mpmath.workdps(DIGITS):
        scaled = scale(problem)
        unknown, steps = start, 0
        for _ in range(30):
            dual = _Dual(scaled, active)
            unknown, vectors, hessian, taken = dual.maximise(unknown)
            steps += taken
            changed = _update_active(scaled, active, unknown, vectors)
            if changed is None:
                return _in_units(problem, scaled, active, unknown, vectors, hessian, dual.metric, steps)
            active, unknown = changed
        raise NotDecidedError("the active torque limits did not settle")


def _update_active(
    scaled: Scaled, active: dict[int, int], unknown: Array, vectors: list[Array]
) -> tuple[dict[int, int], Array] | None:
    """Return the torque limits that are active next, with their multipliers; None where they are right."""
    if not len(scaled.torque_max):
        return None
    torque = scaled.torque_rows @ np.concatenate(vectors)
    kept = {j: (sign, unknown[6 + i]) for i, (j, sign) in enumerate(active.items()) if unknown[6 + i] >= 0}
    broken = {
        j: (1 if torque[j] > 0 else -1, mpf(0))
        for j in range(len(torque))
        if j not in active and abs(torque[j]) > scaled.torque_max[j]
    }
    if len(kept) == len(active) and not broken:
        return None
    following = kept | broken
    return (
        {j: sign for j, (sign, _) in following.items()},
        np.concatenate([unknown[:6], np.array([x for _, x in following.values()], dtype=object)]),
    )


def _in_units(
    problem: SuiteProblem, scaled: Scaled, active: dict[int, int], unknown: Array, vectors: list[Array],
    hessian: Array, metric: Array, steps: int,
) -> Optimum:  # fmt: skip
    n = len(problem.friction)
    forces, moments = exact(np.zeros((n, 3))), exact(np.zeros(n))
    normals = [a / norm(a) for a in exact(problem.normals)]
    for i in range(n):
        forces[i] = exact(problem.squeeze)[i] * normals[i]
    for i, vector, spin in zip(scaled.movable, vectors, scaled.spin_radius, strict=True):
        forces[i] = scaled.load * vector[:3]
        moments[i] = scaled.load * spin * vector[3] if len(vector) == 4 else mpf(0)
    multiplier = _twist(scaled, unknown[:6]) * (scaled.load / scaled.unit)
    torques = exact(np.zeros(0 if problem.torque_max is None else len(problem.torque_max)))
    for i, (j, sign) in enumerate(active.items()):
        torques[j] = sign * unknown[6 + i] * scaled.load / scaled.unit
    return Optimum(forces, moments, multiplier, torques, _condition(hessian[:6, :6], metric[:6, :6]), steps)


def _twist(scaled: Scaled, unknown: Array) -> Array:
    """Convert scaled (linear, angular) components to a twist about the frame's origin."""
    angular = unknown[3:] / scaled.length
    return np.concatenate([unknown[:3] - cross(angular, scaled.centre), angular])


def _condition(hessian: Array, metric: Array) -> float:
    """Return the ratio of the extreme eigenvalues of the Hessian, whitened by the metric, zeros left out."""
    sizes, vectors = mpmath.eigsy(mpmath.matrix(metric.tolist()))
    kept = [i for i in range(6) if sizes[i] > mpf("1e-50") * sizes[5]]
    basis = np.array([[vectors[r, i] / mpmath.sqrt(sizes[i]) for i in kept] for r in range(6)], dtype=object)
    whitened = mpmath.matrix((basis.T @ hessian @ basis).tolist())
    values = list(mpmath.eigsy(whitened, eigvals_only=True))
    nonzero = [x for x in values if x > mpf("1e-20")]
    return float(max(nonzero) / min(nonzero)) if nonzero else float("inf")


def nearest_wrench(problem: SuiteProblem, wrench: Array, widened: mpf = ZERO) -> tuple[Array, mpf]:
    """Return w minus the nearest wrench that the contacts can exert, a twist in scaled coordinates, and its length.

    Args:
        problem: the contacts.
        wrench: w ``(6,)`` in the problem's scaled coordinates.
        widened: as for ``scale``.
    """
    scaled = scale(problem, widened)
    maps = list(zip(scaled.maps, scaled.normals, scaled.friction, strict=True))
    identity = exact(np.eye(6))

    def evaluate(d: Array, epsilon: mpf, derivative: bool = True) -> tuple[mpf, Array, Array | None]:
        """Evaluate w.d - |d|^2 / 2 - sum of |projection of G_i^T d|^2 / (2 epsilon), which is concave."""
        value, gradient, hessian = wrench @ d - d @ d / 2, wrench - d, identity.copy() if derivative else None
        for grasp_map, normal, mu in maps:
            best, jacobian = project(grasp_map.T @ d, normal, mu, derivative)
            value -= best @ best / (2 * epsilon)
            gradient = gradient - grasp_map @ best / epsilon
            if derivative:
                hessian = hessian + grasp_map @ jacobian @ grasp_map.T / epsilon
        return value, gradient, hessian

    d = wrench.copy()
    for stage in range(0, 46, 3):
        epsilon = mpf(10) ** (-stage)
        value, gradient, hessian = evaluate(d, epsilon)
        for _ in range(100):
            if norm(gradient) < mpf("1e-60") * max(1, 1 / epsilon) ** mpf("0.5"):
                break
            direction = solve_linear(hessian, gradient)
            slope, length = direction @ gradient, mpf(1)
            if slope < mpf("1e-140"):
                break
            while evaluate(d + length * direction, epsilon, False)[0] < value + length * slope / 10000 - mpf(
                "1e-70"
            ) * (1 + abs(value)):
                length /= 2
                if length < mpf("1e-25"):
                    raise NotDecidedError("the line search of the nearest wrench failed")
            d = d + length * direction
            value, gradient, hessian = evaluate(d, epsilon)
    return d, norm(d)


def certificate(problem: SuiteProblem, escape: np.ndarray | None = None) -> Array:
    """Return the twist about the frame's origin, of unit size, that proves that no forces exist.

    Rounding must not spoil it. So ``ESCAPE`` of a twist is added along which every contact can only do negative work;
    where there is none, it is computed for friction wider by ``WIDENED``.

    Args:
        problem: an infeasible one.
        escape: the twist ``(6,)``, where there is one.

    Raises:
        NotDecidedError: where the wider cones can exert the wrench.
    """
    with mpmath.workdps(DIGITS):
        widened = WIDENED if escape is None else ZERO
        scaled = scale(problem, widened)
        d, size = nearest_wrench(problem, scaled.wrench, widened)
        if size < mpf("1e-18"):
            raise NotDecidedError(f"the wrench is reachable within {mpmath.nstr(size, 3)} of the load")
        twist = _twist(scaled, d)
        twist = twist / norm(twist)
        if escape is not None:
            twist = twist + ESCAPE / norm(exact(escape)) * exact(escape)
        return twist


def distance(problem: SuiteProblem) -> mpf:
    """Return the distance of the wrench from those that the contacts can exert, over the load."""
    with mpmath.workdps(DIGITS):
        return nearest_wrench(problem, scale(problem).wrench)[1]


def escape_twist(problem: SuiteProblem) -> np.ndarray | None:
    """Return a twist ``(6,)`` along which every contact can only do negative work, by Clarabel; None if there is none.

    It maximises t with v.a + mu |v_t| <= -t for all contacts, over twists of at most unit size in scaled coordinates.
    """
    import clarabel
    from scipy import sparse

    scaled = scale(problem)
    rows, bound, kinds = [], [], []
    for grasp_map, normal, mu in zip(scaled.maps, scaled.normals, scaled.friction, strict=True):
        motion, a, friction = np.asarray(grasp_map.T, float), np.asarray(normal, float), float(mu)
        along = a @ motion
        across = friction * (motion - np.outer(a, along))
        rows.append(np.column_stack([np.concatenate([along[None], -across]), [1.0] + [0.0] * len(across)]))
        bound.append(np.zeros(1 + len(across)))
        kinds.append(clarabel.SecondOrderConeT(1 + len(across)))
    rows.append(np.column_stack([np.concatenate([np.zeros((1, 6)), -np.eye(6)]), np.zeros(7)]))
    bound.append(np.array([1.0] + [0.0] * 6))
    kinds.append(clarabel.SecondOrderConeT(7))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cost = np.array([0.0] * 6 + [-1.0])
    matrix = sparse.csc_matrix(np.concatenate(rows))
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix((7, 7)), cost, matrix, np.concatenate(bound), kinds, settings
    ).solve()
    x = np.array(answer.x)
    return np.asarray(_twist(scaled, exact(x[:6])), float) if x[6] > 1e-7 else None


def limit(problem: SuiteProblem, direction: np.ndarray) -> mpf:
    """Return the largest theta with which the contacts can exert wrench + theta direction.

    Newton's method on the distance from the reachable wrenches, from outside: each plane that separates the wrench from
    them bounds theta from above. The wrench itself must be reachable, and the direction leave the reachable wrenches.
    """
    with mpmath.workdps(DIGITS):
        start = scale(problem)
        moved = problem._replace(wrench=np.asarray(direction, float))
        # The direction in the same coordinates, whose load differs, and the squeeze of contacts that cannot move.
        along = scale(moved)
        if len(start.movable) < len(problem.friction):
            raise ValueError("limits are computed for contacts that can all move")
        stride = along.wrench * along.load / start.load
        theta = mpf(10) * (1 + 1 / norm(stride))
        for _ in range(40):
            d, size = nearest_wrench(problem, start.wrench + theta * stride)
            if size < mpf("1e-28") * norm(stride):
                # Nearer to the limit the regularisation, not the plane, would rule the next bound.
                return theta
            rise = d @ stride
            if rise <= 0:
                raise NotDecidedError("the direction does not leave the reachable wrenches")
            bound = -(d @ start.wrench) / rise
            theta = bound
        raise NotDecidedError("the limit did not converge")
