"""Batches of grasp problems, and independent references and judges of them: NumPy in extended precision, and Clarabel.

Nothing here comes from the solver. Generators make the batches, as plain arrays.

Everything but Clarabel works on batches: points and normals ``(B, n, 3)``, friction, squeeze and sharing weights
``(B, n)``, wrench ``(B, 6)``, as ``np.longdouble`` inside (64-bit mantissa on x86). Where the platform's long double
is a double, ``EXTENDED`` is False and the judgements are only as fine as that.
"""

from typing import NamedTuple

import numpy as np


class Contacts(NamedTuple):
    """Contacts before a wrench is chosen."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray


class Problems(NamedTuple):
    """A batch of problems of one kind, in float64."""

    kind: str
    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    wrench: np.ndarray
    feasible: bool | None
    """True or False where the construction decides it for every sharing; None where it depends on the sharing."""
    witness: np.ndarray | None = None
    """Allowed forces ``(B, n, 3)`` that the wrench was made of, where there are any."""

    def cast(self, dtype: type) -> "Problems":
        """Round the problems to ``dtype``; the rounded problems are different problems, and so without a witness."""
        arrays = {name: getattr(self, name).astype(dtype) for name in (*Contacts._fields, "wrench")}
        return self._replace(**arrays, witness=None)

    def weights(self, sharing: str) -> np.ndarray:
        """Return the sharing weights k ``(B, n)`` of a named method, ``squeeze`` or ``uniform``."""
        return {"squeeze": self.squeeze, "uniform": np.ones_like(self.squeeze)}[sharing]


Wide = np.longdouble
EXTENDED = np.finfo(Wide).eps < 1e-18


class Centred(NamedTuple):
    """A problem about the weighted centroid, lengths in units of the weighted radius, in extended precision."""

    arms: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    weights: np.ndarray
    wrench: np.ndarray
    centre: np.ndarray
    length: np.ndarray

    def scaled_twist(self, twist: np.ndarray) -> np.ndarray:
        """Move a (linear, angular) vector ``(B, 6)`` from the frame's origin to the centroid, in unit ``length``."""
        twist = np.asarray(twist, Wide)
        linear = twist[:, :3] + np.cross(twist[:, 3:], self.centre)
        return np.concatenate([linear, twist[:, 3:] * self.length[:, None]], -1)

    def velocities(self, scaled_twist: np.ndarray) -> np.ndarray:
        """Compute G^T twist, the velocity ``(B, n, 3)`` at each contact."""
        return scaled_twist[:, None, :3] + np.cross(scaled_twist[:, None, 3:], self.arms)


class Judgement(NamedTuple):
    """Quality of forces and a multiplier; ``gap`` and ``rounding`` depend on both."""

    backward_error: np.ndarray
    """|w - G f| / (|w| + sum |G_i| max(|f_i|, s_i)), centred and length-scaled.

    The squeezing forces count as data: without them an optimum of zero force, right to the last digit of what it was
    computed from, would have no meaningful error."""
    violation: np.ndarray
    """Largest distance of a force from its cone, relative to the largest force or squeeze."""
    primal: np.ndarray
    dual: np.ndarray
    gap: np.ndarray
    """|primal - dual| relative to max(primal, sum of s^2 / 2k)."""
    rounding: np.ndarray
    """Change of the optimum, on the scale of ``gap``, when every wrench entry and point coordinate moves by one
    rounding of its own dtype: no method that reads these data can be expected to do much better."""


def centred(problem: Problems, weights: np.ndarray, present: np.ndarray | None = None) -> Centred:
    """Convert the problem to centred coordinates in extended precision; absent contacts get zero data."""
    p, a = np.asarray(problem.points, Wide), np.asarray(problem.normals, Wide)
    mu, s, k = (np.asarray(x, Wide) for x in (problem.friction, problem.squeeze, weights))
    if present is not None:
        is_present = present > 0.5
        p, a = (np.where(is_present[..., None], x, 0) for x in (p, a))
        mu, s, k = (np.where(is_present, x, 0) for x in (mu, s, k))
    a = a / or_one(norm(a))[..., None]
    share = k / or_one(k.sum(-1, keepdims=True))
    centre = np.sum(share[..., None] * p, 1)
    arms = np.where(k[..., None] > 0, p - centre[:, None], p - centre[:, None] if present is None else 0)
    length = np.sqrt(np.sum(share * np.sum(arms**2, -1), -1))
    # Contacts in one point, but for rounding of the mean, have no length of their own.
    tiny = 16 * np.finfo(Wide).eps * norm(centre)
    length = np.where(length > tiny, length, or_one(norm(centre)))
    force, torque = np.asarray(problem.wrench, Wide)[:, :3], np.asarray(problem.wrench, Wide)[:, 3:]
    about = (torque - np.cross(centre, force)) / length[:, None]
    return Centred(arms / length[:, None, None], a, mu, s, k, np.concatenate([force, about], -1), centre, length)


def judge(
    problem: Problems,
    weights: np.ndarray,
    forces: np.ndarray,
    multiplier: np.ndarray,
    present: np.ndarray | None = None,
) -> Judgement:
    """Judge the primal and dual quality of a proposed optimum of the cone-constrained problem.

    Any multiplier gives a lower bound of the optimum (weak duality) and any allowed, balancing forces an upper one;
    so a small gap with a small backward error and violation proves the answer, whoever computed it.
    """
    scaled = centred(problem, weights, present)
    f = np.asarray(forces, Wide)
    twist = scaled.scaled_twist(multiplier)
    primal, no_force_cost = _deviation_cost(scaled, f).sum(-1), _deviation_cost(scaled, np.zeros_like(f)).sum(-1)
    dual = dual_objective(scaled, twist)
    scale = np.maximum(primal, no_force_cost)
    difference = np.abs(primal - dual)
    gap = np.where(difference == 0, 0, difference / np.where(scale > 0, scale, np.finfo(float).tiny))
    largest = np.maximum(norm(f).max(-1), scaled.squeeze.max(-1))
    # A contact of weight zero keeps its squeezing force, which lies on its normal.
    distance = norm(f - project(f, scaled.normals, scaled.friction)).max(-1)
    moved = _rounding(problem, np.asarray(multiplier, Wide), np.where(scaled.weights[..., None] > 0, f, 0))
    return Judgement(backward_error(scaled, f), distance / or_one(largest), primal, dual, gap, moved / or_one(scale))


def _rounding(problem: Problems, twist: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Estimate the change of the optimum ``(B,)`` when wrench and points move by one rounding.

    The multiplier is the optimum's derivative by the wrench; its cross product with f, the derivative by the points.
    """
    through_wrench = np.sum(np.abs(twist * problem.wrench), -1)
    by_points = np.abs(np.cross(forces, twist[:, None, 3:]))
    through_points = np.sum(by_points * np.abs(np.where(forces != 0, problem.points, 0)), (-1, -2))
    return np.finfo(problem.wrench.dtype).eps * (through_wrench + through_points)


def dual_objective(scaled: Centred, twist: np.ndarray) -> np.ndarray:
    """Compute q(twist) = w.twist + sum of min over the cone of |f - s a|^2 / 2k - v.f; fixed contacts give -v.s a."""
    v = scaled.velocities(twist)
    target = scaled.squeeze[..., None] * scaled.normals
    best = project(target + scaled.weights[..., None] * v, scaled.normals, scaled.friction)
    best = np.where(scaled.weights[..., None] > 0, best, target)
    return np.sum(scaled.wrench * twist, -1) + (_deviation_cost(scaled, best) - np.sum(v * best, -1)).sum(-1)


def project(u: np.ndarray, normals: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Project ``u`` ``(B, n, 3)`` onto the Coulomb cones, by three cases: inside, apex, surface."""
    along = np.sum(u * normals, -1)
    across = u - along[..., None] * normals
    size = norm(across)
    inside = (size <= friction * along) & (along >= 0)
    apex = ~inside & (friction * size <= -along)
    height = (along + friction * size) / (1 + friction**2)
    direction = across / or_one(size)[..., None]
    edge = height[..., None] * (normals + friction[..., None] * direction)
    return np.where(inside[..., None], u, np.where(apex[..., None], 0, edge))


def backward_error(scaled: Centred, forces: np.ndarray) -> np.ndarray:
    reach = np.sqrt(1 + np.sum(scaled.arms**2, -1))
    residual = scaled.wrench - resultant(scaled, forces)
    size = norm(scaled.wrench) + np.sum(reach * np.maximum(norm(forces), scaled.squeeze), -1)
    return norm(residual) / or_one(size)


def resultant(scaled: Centred, forces: np.ndarray) -> np.ndarray:
    return np.concatenate([forces.sum(1), np.cross(scaled.arms, forces).sum(1)], -1)


def closed_form_reference(
    problem: Problems, weights: np.ndarray, present: np.ndarray | None = None, cut: float = 1e-14
) -> tuple[np.ndarray, np.ndarray]:
    """Compute closed-form forces and rank, by a one-sided Jacobi SVD of W^(1/2) G^T in extended precision.

    Singular values below ``cut`` times the largest count as zero: the forces are then those that balance what
    can be balanced, by the multiplier of minimal norm.
    """
    scaled = centred(problem, weights, present)
    root = np.sqrt(scaled.weights / or_one(scaled.weights.max(-1, keepdims=True)))
    columns = np.stack(
        [scaled.velocities(np.broadcast_to(np.eye(6, dtype=Wide)[i], (len(root), 6))) for i in range(6)], 1
    )
    left = (root[:, None, :, None] * columns).reshape(len(root), 6, -1)
    right = np.broadcast_to(np.eye(6, dtype=Wide), (len(root), 6, 6)).copy()
    left, right = _orthogonalise(left, right)
    sizes = norm(left)
    significant = sizes > cut * sizes.max(-1, keepdims=True)
    squeezing = scaled.squeeze[..., None] * scaled.normals
    residual = scaled.wrench - resultant(scaled, squeezing)
    multiplier = np.where(
        significant, np.einsum("bij,bj->bi", right, residual) / np.where(significant, sizes, 1) ** 2, 0
    )
    moved = np.einsum("bi,bij->bj", multiplier, left).reshape(squeezing.shape)
    forces = squeezing + root[..., None] * moved
    return forces, np.where(scaled.weights.sum(-1) > 0, significant.sum(-1), 0)


def _orthogonalise(left: np.ndarray, right: np.ndarray, sweeps: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """Rotate rows of ``left`` until they are orthogonal (Hestenes), and ``right`` along with them."""
    for _ in range(sweeps):
        for p in range(5):
            for q in range(p + 1, 6):
                lp, lq = left[:, p].copy(), left[:, q].copy()
                mixed = np.sum(lp * lq, -1)
                half_gap = (np.sum(lq * lq, -1) - np.sum(lp * lp, -1)) / 2
                reach = np.abs(half_gap) + np.sqrt(half_gap**2 + mixed**2)
                tangent = np.where(half_gap < 0, -mixed, mixed) / or_one(reach)
                cosine = (1 / np.sqrt(1 + tangent**2))[:, None]
                sine = tangent[:, None] * cosine
                left[:, p], left[:, q] = cosine * lp - sine * lq, sine * lp + cosine * lq
                rp, rq = right[:, p].copy(), right[:, q].copy()
                right[:, p], right[:, q] = cosine * rp - sine * rq, sine * rp + cosine * rq
    return left, right


def proven_need(
    problem: Problems, weights: np.ndarray, certificate: np.ndarray, present: np.ndarray | None = None
) -> np.ndarray:
    """Compute the total normal force, in units of the load, that a certificate proves any solution to need.

    For allowed forces w.d = sum of f_i.v_i <= (sum of normal forces) times the largest work per unit of normal
    force; the load is squeeze, force, and torque over the contacts' radius. Infinite where no contact can do any
    work along d; zero or less where d proves nothing.
    """
    scaled = centred(problem, weights, present)
    twist = scaled.scaled_twist(certificate)
    v = scaled.velocities(twist)
    along = np.sum(v * scaled.normals, -1)
    support = along + scaled.friction * norm(v - along[..., None] * scaled.normals)
    movable = scaled.weights > 0
    work = np.sum(scaled.wrench * twist, -1) - np.sum(np.where(movable, 0, scaled.squeeze * along), -1)
    largest = np.max(np.where(movable, support, 0), -1)
    load = scaled.squeeze.sum(-1) + norm(scaled.wrench[:, :3]) + norm(scaled.wrench[:, 3:])
    with np.errstate(divide="ignore", invalid="ignore"):
        need = np.where(largest > 0, work / np.where(largest > 0, largest, 1), np.where(work > 0, np.inf, 0))
        return need / or_one(load)


def clarabel_optimum(
    problem: Problems, weights: np.ndarray, index: int | np.integer = 0
) -> tuple[np.ndarray, np.ndarray, str]:
    """Solve a problem of a batch by Clarabel; return forces, multiplier about the frame's origin, and status.

    The cones are posed as they are, in the contact's own axes, on a problem brought to order one. Contacts of
    weight zero are constants. The status says ``Solved`` for an optimum and ``PrimalInfeasible`` for a proof of
    none; judge the answer by ``judge`` before trusting it.
    """
    import clarabel
    from scipy import sparse

    single = problem._replace(**{name: getattr(problem, name)[index : index + 1] for name in ARRAYS})
    scaled = centred(single, weights[index : index + 1])
    arms, normals, mu, s, k, w = (np.asarray(x[0], float) for x in scaled[:6])
    load = float(s.sum() + np.linalg.norm(w)) or 1.0
    free = k > 0
    n_free, unit = int(free.sum()), float(k.sum()) or 1.0
    held = np.where(free[:, None], 0, s[:, None] * normals)
    residual = (w - np.concatenate([held.sum(0), np.cross(arms, held).sum(0)])) / load
    k_free, s_free = k[free] / unit, s[free] / load
    cost = sparse.csc_matrix(np.diag(np.repeat(1 / k_free, 3)))
    linear = -((s_free / k_free)[:, None] * normals[free]).ravel()
    grasp = np.concatenate([np.concatenate([np.eye(3), _cross_matrix(r)]) for r in arms[free]], 1)
    cones = np.zeros((3 * n_free, 3 * n_free))
    for i, (a, m) in enumerate(zip(normals[free], mu[free], strict=True)):
        cones[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = -np.vstack([m * a, *tangents(a)])
    normal_rows = np.zeros((n_free, 3 * n_free))
    for i, a in enumerate(normals[free]):
        # With no friction the second-order cone would let a force pull.
        normal_rows[i, 3 * i : 3 * i + 3] = -a
    constraints = sparse.csc_matrix(np.concatenate([grasp, normal_rows, cones]))
    bound = np.concatenate([residual, np.zeros(4 * n_free)])
    kinds = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(n_free)] + [clarabel.SecondOrderConeT(3)] * n_free
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 200
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    settings.tol_infeas_abs = settings.tol_infeas_rel = 1e-10
    answer = clarabel.DefaultSolver(cost, linear, constraints, bound, kinds, settings).solve()
    forces = held.copy()
    forces[free] += load * np.asarray(answer.x).reshape(-1, 3)
    twist = -np.asarray(answer.z)[:6] * load / unit
    centre, length = np.asarray(scaled.centre[0], float), float(scaled.length[0])
    angular = twist[3:] / length
    return forces, np.concatenate([twist[:3] - np.cross(angular, centre), angular]), str(answer.status)


ARRAYS = ("points", "normals", "friction", "squeeze", "wrench")


def tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)


def _cross_matrix(r: np.ndarray) -> np.ndarray:
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def _deviation_cost(scaled: Centred, forces: np.ndarray) -> np.ndarray:
    deviation = forces - scaled.squeeze[..., None] * scaled.normals
    moves = scaled.weights > 0
    return np.where(moves, np.sum(deviation**2, -1) / np.where(moves, 2 * scaled.weights, 1), 0)


def norm(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.sum(np.asarray(vectors) ** 2, -1))


def or_one(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, 1)
