"""Seeded problems whose numbers lie hundreds of orders of magnitude apart, some of them NaN, infinite or zero.

Their answers are judged from the definitions alone, in extended precision, whose range no product here exceeds.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from jaxgrasp import Verdict

Wide = np.longdouble
SPECIAL = (np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0)
SPANS = {"float64": (1, 6, 40, 123, 300), "float32": (1, 3, 10, 15, 38)}
"""Powers of ten up to which the numbers of a problem are multiplied, by precision; a problem has one of them."""


class ExtremeProblem(NamedTuple):
    """A batch ``(B, n, ...)``; fields that are None are left out."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    wrench: np.ndarray
    weights: np.ndarray
    torsion: np.ndarray | None
    normal_min: np.ndarray | None
    normal_max: np.ndarray | None


class Judgement(NamedTuple):
    """Judgement of the answers."""

    broken: dict[str, np.ndarray]
    """Masks ``(B,)`` of the problems whose answers break a law, by its name."""

    def check(self, text: str) -> None:
        """Raise AssertionError with the indices of the problems whose answers break a law."""
        for law, mask in self.broken.items():
            assert not mask.any(), f"{law}: {text}, problems {np.flatnonzero(mask)[:10]}"


def extreme_problem(seed: int, n: int, count: int, dtype: str, is_soft: bool, is_bounded: bool) -> ExtremeProblem:
    """Draw a batch; the same arguments give the same one."""
    rng = np.random.default_rng([seed, n, is_soft, is_bounded, dtype == "float32"])
    span = rng.choice(SPANS[dtype], count)
    # Half of the problems have ordinary numbers in most of their fields.
    varies = np.where(rng.uniform(size=count) < 0.5, 0.2, 1)
    shape = (count, n)

    def magnified(array: np.ndarray) -> np.ndarray:
        """Multiply a field by a power of ten, in a third of the problems another one for each number."""
        ones = (1,) * (array.ndim - 1)
        shared = rng.uniform(-1, 1, (count, *ones))
        exponent = np.where(rng.uniform(size=shared.shape) < 0.33, rng.uniform(-1, 1, array.shape), shared)
        changes = rng.uniform(size=shared.shape) < varies.reshape(count, *ones)
        with np.errstate(over="ignore"):
            return array * np.where(changes, 10.0 ** (span.reshape(count, *ones) * exponent), 1)

    frame = rng.choice([0.0, 1.0], (count, 1, 1)) * magnified(rng.normal(size=(count, 1, 3)))
    points = magnified(rng.normal(size=(*shape, 3))) + frame
    # A tenth of the grasps has all contacts at one point.
    points = np.where(rng.uniform(size=(count, 1, 1)) < 0.1, points[:, :1], points)
    normals = rng.normal(size=(*shape, 3))
    friction, squeeze = magnified(rng.uniform(0, 1, shape)), magnified(rng.uniform(0, 5, shape))
    torsion = magnified(rng.uniform(0, 0.1, shape)) if is_soft else None
    normal_min = magnified(rng.uniform(0, 0.5, shape) * (rng.uniform(size=shape) < 0.5)) if is_bounded else None
    normal_max = None if normal_min is None else normal_min + magnified(rng.uniform(0, 5, shape))
    weights = np.where(rng.uniform(size=(count, 1)) < 0.5, squeeze, magnified(rng.uniform(0, 1, shape)))
    wrench = np.where(
        rng.uniform(size=(count, 1)) < 0.5,
        _wrench_of_allowed_forces(rng, points, normals, friction, squeeze, torsion, (normal_min, normal_max)),
        magnified(rng.normal(size=(count, 2, 3))).reshape(count, 6),
    )
    drawn = ExtremeProblem(
        points, magnified(normals), friction, squeeze, wrench, weights, torsion, normal_min, normal_max
    )
    share = rng.choice([0, 0.02, 0.1], count, p=[0.8, 0.1, 0.1])
    fields = [None if array is None else _with_special_numbers(rng, array, share) for array in drawn]
    with np.errstate(over="ignore"):
        return ExtremeProblem(*(None if array is None else array.astype(dtype) for array in fields))


def _with_special_numbers(rng: Generator, array: np.ndarray, share: np.ndarray) -> np.ndarray:
    special = rng.choice(SPECIAL, array.shape)
    return np.where(rng.uniform(size=array.shape) < share.reshape(-1, *(1,) * (array.ndim - 1)), special, array)


def _wrench_of_allowed_forces(
    rng: Generator,
    points: np.ndarray,
    normals: np.ndarray,
    friction: np.ndarray,
    squeeze: np.ndarray,
    torsion: np.ndarray | None,
    bounds: tuple[np.ndarray | None, np.ndarray | None],
) -> np.ndarray:
    p, a, mu, s = (np.asarray(array, Wide) for array in (points, normals, friction, squeeze))
    a = a / np.sqrt(_square(a))[..., None]
    along = s * rng.uniform(0, 2, s.shape)
    for bound, clip in zip(bounds, (np.maximum, np.minimum), strict=True):
        along = along if bound is None else clip(along, np.asarray(bound, Wide))
    across = np.cross(a, rng.normal(size=a.shape))
    across = across / np.sqrt(_square(across))[..., None]
    used = rng.uniform(0, 0.7, s.shape)
    forces = along[..., None] * (a + (used * mu)[..., None] * across)
    moments = 0 if torsion is None else along * np.asarray(torsion, Wide) * rng.uniform(-0.7, 0.7, s.shape)
    torque = np.cross(p, forces).sum(1) + (np.asarray(moments)[..., None] * a).sum(1)
    with np.errstate(over="ignore"):
        return np.concatenate([forces.sum(1), torque], -1).astype(float)


class Allowed(NamedTuple):
    """Tolerances of one precision."""

    force: float
    """Part of the numbers that are summed that the forces may miss of the wrench's force."""
    torque: float
    """The same of its torque."""
    cone: float
    """Distance from a cone, as a part of the largest force."""
    bound: float
    """Part of a bound of a normal force by which it may be missed."""
    proof: float
    """Loads that a proof reaches at least."""
    coincident: float
    """Spread of the points, as a part of the frame's distance, below which they coincide but for rounding."""


ALLOWED = {
    "float64": Allowed(1e-7, 1e-5, 1e-12, 1e-9, 4e5, 1e-13),
    "float32": Allowed(2e-3, 3e-2, 1e-5, 1e-5, 20.0, 1e-4),
}
ANSWERS = (Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE)


@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def judge(problem: ExtremeProblem, solution: Any) -> Judgement:
    """Judge what each verdict claims; ``solution`` has the fields of a Solution as NumPy arrays."""
    allowed = ALLOWED[problem.points.dtype.name]
    verdict = np.asarray(solution.verdict)
    is_answer, is_infeasible = np.isin(verdict, ANSWERS), verdict == Verdict.INFEASIBLE
    is_balanced = is_answer | (verdict == Verdict.OUTSIDE_CONES)
    p, a, mu, s, w, k = (np.asarray(array, Wide) for array in problem[:6])
    torsion, low, high = (None if array is None else np.asarray(array, Wide) for array in problem[6:])
    a = a / np.sqrt(_square(a))[..., None]
    moments = np.zeros_like(s) if torsion is None else np.asarray(solution.moments, Wide)
    f = np.asarray(solution.forces, Wide)
    is_finite = np.isfinite(f).all((1, 2)) & np.isfinite(moments).all(-1)
    along = np.sum(f * a, -1)
    spin = np.zeros_like(s) if torsion is None else np.where(moments == 0, 0, mu * moments / torsion)
    across = np.sqrt(_square(f - along[..., None] * a) + spin**2)
    largest = np.maximum(np.sqrt(_square(f) + spin**2).max(-1, keepdims=True), 0)
    # Distance from the cone's surface, and from its apex beyond that.
    outside = np.maximum((across - mu * along) / np.sqrt(1 + mu**2), -along)
    # The tangent of a force loses digits beside friction beyond 1, and where the squeeze is far larger than the force.
    granted = allowed.cone * np.maximum(1, mu) * np.maximum(largest, s)
    misses_bound = np.zeros(verdict.shape, bool)
    if low is not None and high is not None:
        info = np.finfo(problem.points.dtype)
        slack = (
            info.tiny / info.eps * largest
            + allowed.cone * np.sqrt(_square(f))
            + allowed.bound * np.maximum(1, mu) * np.stack([low, np.where(high < np.inf, high, 0)])
        )
        misses_bound = ~((along >= low - slack[0]) & (along <= high + slack[1])).all(-1)
    broken = {
        "finite forces": is_balanced & ~is_finite,
        "finite multiplier": (verdict <= Verdict.OPTIMAL) & ~np.isfinite(solution.multiplier).all(-1),
        "cones": is_answer & ~(outside <= granted).all(-1),
        "bounds of the normal forces": is_answer & misses_bound,
        "balance": is_balanced & ~_is_balanced(allowed, (p, a, w, k), f, moments),
        "proof": is_infeasible & ~_is_proven(allowed, problem, solution),
        "unusable data": _is_unusable(problem) & (verdict != Verdict.INVALID_DATA),
    }
    return Judgement(broken)


def _square(x: np.ndarray) -> np.ndarray:
    return np.sum(x * x, -1)


def _is_balanced(allowed: Allowed, data: tuple[np.ndarray, ...], f: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Return whether forces balance the wrench, beside the numbers that are summed, about the points' middle."""
    p, a, w, k = data
    # Contacts coincide where their spread is next to nothing, by weight.
    total_weight = np.sum(k, -1, keepdims=True)
    share = np.where(total_weight > 0, k / np.where(total_weight > 0, total_weight, 1), 1 / k.shape[1])
    middle = np.sum(share[..., None] * p, 1)
    r = p - middle[:, None]
    force, torque = w[:, :3], w[:, 3:] - np.cross(middle, w[:, :3])
    total, turned = np.sqrt(_square(f)).sum(-1), np.abs(moments).sum(-1)
    load, turn = np.sqrt(_square(force)), np.sqrt(_square(torque))
    left_force = np.sqrt(_square(force - f.sum(1)))
    left_torque = np.sqrt(_square(torque - np.cross(r, f).sum(1) - (moments[..., None] * a).sum(1)))
    weighted_spread = np.sqrt(np.sum(share * _square(r), -1))
    spread, distance = np.sqrt(_square(r)).max(-1), np.sqrt(_square(middle))
    # Rounding of points far from the origin moves their levers. Contacts that coincide but for it have no lever of
    # their own: their torques are measured by their distance from the origin, or 1 m at the origin.
    eps = np.finfo(np.float64 if allowed.force < 1e-5 else np.float32).eps
    coincides = weighted_spread <= allowed.coincident * distance
    unit = np.where(distance > 0, distance, 1)
    lever = np.maximum(spread, np.where(coincides, allowed.force, 64 * eps) / allowed.torque * unit)
    balances_force = left_force <= allowed.force * (load + total + turn / np.where(lever > 0, lever, 1))
    return balances_force & (
        left_torque <= allowed.torque * (turn + lever * (load + total) + turned) + np.finfo(np.float64).tiny
    )


def _is_proven(allowed: Allowed, problem: ExtremeProblem, solution: Any) -> np.ndarray:
    """Return whether the certificate proves ``force_bound``, and that far beyond the load."""
    p, a, mu, s, w, k = (np.asarray(array, Wide) for array in problem[:6])
    torsion, low, high = (None if array is None else np.asarray(array, Wide) for array in problem[6:])
    a = a / np.sqrt(_square(a))[..., None]
    d = np.asarray(solution.certificate, Wide)
    velocity = d[:, None, :3] + np.cross(d[:, None, 3:], p)
    along = np.sum(velocity * a, -1)
    square = _square(velocity - along[..., None] * a)
    if torsion is not None:
        square = square + np.where(mu > 0, torsion / np.where(mu > 0, mu, 1) * np.sum(d[:, None, 3:] * a, -1), 0) ** 2
    push = along + mu * np.sqrt(square)
    moves = k > 0
    low, high = (0 * s if low is None else low), (0 * s + np.inf if high is None else high)
    is_endless = moves & ~np.isfinite(high)
    limited = np.where(push > 0, push * np.where(np.isfinite(high), high, 0), push * low)
    held = np.clip(s, low, high) * along
    work = np.sum(w * d, -1) - np.sum(np.where(moves, limited, held), -1)
    most = np.where(is_endless, np.maximum(push, 0), 0).max(-1)
    needed = np.where(most > 0, work / np.where(most > 0, most, 1), np.inf)
    bound, load = np.asarray(solution.force_bound, Wide), np.sqrt(_square(w[:, :3]))
    return (work > 0) & (needed >= bound * (1 - 1e-3)) & (bound >= allowed.proof * load) & (bound > 0)


def _is_unusable(problem: ExtremeProblem) -> np.ndarray:
    """Return a mask of problems with a NaN, an infinity or a number below zero where none may be."""
    unusable = ~np.isfinite(problem.wrench).all(-1)
    for name, array in problem._asdict().items():
        if array is None or name == "wrench":
            continue
        is_bad = np.isnan(array) if name == "normal_max" else ~np.isfinite(array)
        if name not in ("points", "normals"):
            is_bad = is_bad | (array < 0)
        unusable = unusable | is_bad.reshape(len(array), -1).any(-1)
    return unusable
