"""Problem of the suite, a solver's answer to it, and its scaled coordinates: what all of the suite's files share."""

from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.testing.references import Wide

VERSION = "1"
"""Version of the collection: problems of a version never change."""

KINDS = {
    "ordinary": "nothing: contacts on an ellipsoid, friction 0.3 to 1; half of the optima have an active cone",
    "near_collinear": "contacts within 1e-7 to 1e-2 of a line: the torque about the line has a tiny lever",
    "coincident": "contacts at one point, in part with one normal: rank 3, and the multiplier is not unique",
    "twins": "half of the contacts coincide, in part with one normal: the split of their load is flat but for the cost",
    "tiny_friction": "friction 1e-6 to 1e-3: cones are needles, and forces and multipliers grow by their inverse",
    "zero_friction": "no friction, on the faces of a box: cones without an interior",
    "huge_friction": "friction 1e1 to 1e6: cones are nearly half-spaces",
    "mixed_friction": "friction of 0, 1e-6 to 1e6 in one grasp",
    "wide_squeeze": "squeezing forces, which are the weights too, over 12 decades in one grasp",
    "idle_contacts": "contacts of weight zero, which can exert nothing",
    "far_frame": "the frame's origin 1 to 1e6 m away: torques lose digits to the lever of the frame",
    "scales": "lengths of 1e-9 to 1e9 m and forces of 1e-9 to 1e9 N",
    "zero_wrench": "no load: the squeezing forces must balance one another",
    "inside_limit": "a load of 1 - 10^-k of the largest, k = 1 to 8: multipliers grow as the limit comes near",
    "outside_limit": "a load of 1 + 10^-k of the largest, k = 1 to 8: infeasible by a hair",
    "infeasible": "far out of reach: contacts all push against one motion, and the load needs work along it",
    "rank_deficient": "two or more fingers on a line with a torque about it that no contact can exert",
    "two_fingers": "two opposite fingers: rank 5, and the load is in their range",
    "soft_fingers": "torsional friction: cones of four dimensions with axes of different length",
    "torque_limits": "bounds of joint torques, some active: linear constraints beside the cones",
    "combined": "near a line, friction 0.05 to 0.1, 0 or 10, squeeze over 5 decades or none, any scale, a far frame",
    "published": "grasps of the literature with known answers, and simulated grips of hand models",
    "once_undecided": "problems that jaxgrasp did not decide, or decided wrongly, in some version or on some device",
}
"""Kinds of problems, and what makes each hard."""


class SuiteProblem(NamedTuple):
    """One problem in float64, taken as exact, with its reference.

    References are pairs of float64, ``(2, ...)``, whose sum has 31 digits: ``np.longdouble(x[0]) + x[1]``.
    """

    name: str
    kind: str
    points: np.ndarray
    """``(n, 3)`` [m]."""
    normals: np.ndarray
    """Into the object ``(n, 3)``, of length 1 within 1e-6; their direction counts."""
    friction: np.ndarray
    squeeze: np.ndarray
    """s ``(n,)`` [N]."""
    wrench: np.ndarray
    """w, (force, torque about the frame's origin) ``(6,)`` [N, N.m]."""
    weights: np.ndarray
    """k ``(n,)``."""
    torsion: np.ndarray | None = None
    """Torsional friction of soft fingers ``(n,)`` [m]: |f_t|^2 / mu^2 + m^2 / torsion^2 <= (f.a)^2; the cost of the
    moment m is m^2 mu^2 / (torsion^2 2 k). None for hard fingers."""
    torque_map: np.ndarray | None = None
    """Torques of j joints by the forces ``(n, 3, j)`` [m]; None without limits."""
    torque_max: np.ndarray | None = None
    """Bounds of their absolute values ``(j,)`` [N.m]."""
    feasible: bool = True
    forces: np.ndarray = np.zeros((2, 0, 3))
    """Optimal forces ``(2, n, 3)`` [N]; zero where infeasible."""
    moments: np.ndarray = np.zeros((2, 0))
    """Optimal moments about the normals ``(2, n)`` [N.m]."""
    multiplier: np.ndarray = np.zeros((2, 6))
    """Multiplier of G f = w, a derivative of the optimum by w; one of many where the rank is below 6."""
    torque_multiplier: np.ndarray = np.zeros((2, 0))
    """Signed multipliers of the torque bounds ``(2, j)``."""
    certificate: np.ndarray = np.zeros((2, 6))
    """Twist d with w.d > 0 along which no contact can do work, where infeasible; else zero."""
    grasp_condition: float = float("nan")
    """Ratio of the extreme singular values of G W^(1/2), centred, in weighted radii, zeros left out."""
    hessian_condition: float = float("nan")
    """Ratio of the extreme eigenvalues of the dual's Hessian at the optimum in whitened coordinates, zeros left out."""
    distance: float = float("nan")
    """Distance of the load from the limit of what can be exerted, relative to it, where the construction knows it."""

    def wide(self, field: str) -> np.ndarray:
        """Return a reference in the platform's long double."""
        high, low = getattr(self, field)
        return np.asarray(high, Wide) + np.asarray(low, Wide)

    @property
    def optimum(self) -> np.longdouble:
        """Objective of the reference."""
        return objective(self, self.wide("forces"), self.wide("moments"))


class Claim(StrEnum):
    """Report of a solver about a problem."""

    SOLVED = "solved"
    """Solved to the solver's tolerance."""
    INFEASIBLE = "infeasible"
    """No forces exist."""
    FAILED = "failed"
    """Anything else, such as almost solved, or an exception."""


class Answer(NamedTuple):
    """A solver's answer in the user's units."""

    claim: Claim
    forces: np.ndarray | None = None
    """``(n, 3)`` [N], where solved."""
    moments: np.ndarray | None = None
    """``(n,)`` [N.m], where solved and fingers are soft."""
    certificate: np.ndarray | None = None
    """Twist ``(6,)`` about the frame's origin, where infeasible and the solver gives one."""
    seconds: float = float("nan")
    text: str = ""
    """The solver's own status."""


class Outcome(StrEnum):
    """Judgement of an answer."""

    RIGHT = "right"
    """Feasible, solved, and within tolerance of the reference."""
    WRONG = "wrong in silence"
    """Feasible and claimed as solved, but outside the tolerance; or claimed as infeasible."""
    SAID_SO = "said so"
    """Neither claimed as solved nor as infeasible."""
    PROVEN = "infeasible proven"
    """Infeasible, claimed so, with a twist that proves it."""
    CLAIMED = "infeasible claimed"
    """Infeasible, claimed so, without a twist or with one that proves nothing."""
    INFEASIBLE_SOLVED = "infeasible called solved"


def norm(vectors: np.ndarray) -> Any:
    """Return the lengths along the last axis: an array, or a number of one vector."""
    return np.sqrt(np.sum(np.asarray(vectors) ** 2, -1))


def or_one(values: Any) -> Any:
    """Return an array or a number, with ones in place of what is not positive."""
    return np.where(values > 0, values, 1)[()]


class Frame(NamedTuple):
    """Centred, length-scaled coordinates of a problem, in long double."""

    arms: np.ndarray
    normals: np.ndarray
    wrench: np.ndarray
    centre: np.ndarray
    length: np.longdouble
    load: np.longdouble
    """Sum of squeeze, force, and torque over the length [N]."""


def frame(problem: SuiteProblem) -> Frame:
    """Return the coordinates about the weighted centroid, in weighted radii."""
    points, normals = np.asarray(problem.points, Wide), np.asarray(problem.normals, Wide)
    weights, wrench = np.asarray(problem.weights, Wide), np.asarray(problem.wrench, Wide)
    normals = normals / norm(normals)[:, None]
    share = weights / or_one(weights.sum())
    centre = share @ points
    arms = points - centre
    length = np.sqrt(share @ np.sum(arms**2, -1))
    if length <= 16 * np.finfo(Wide).eps * norm(centre):
        length = or_one(norm(centre))
    torque = (wrench[3:] - np.cross(centre, wrench[:3])) / length
    scaled = np.concatenate([wrench[:3], torque])
    load = or_one(np.sum(np.asarray(problem.squeeze, Wide)) + norm(wrench[:3]) + norm(torque))
    return Frame(arms / length, normals, scaled, centre, length, load)


def spin_radius(problem: SuiteProblem) -> np.ndarray:
    """Return torsion over friction of each contact ``(n,)`` [m]; zero for hard fingers and where friction is zero."""
    if problem.torsion is None:
        return np.zeros(len(problem.friction))
    has_friction = problem.friction > 0
    return np.where(has_friction, problem.torsion / np.where(has_friction, problem.friction, 1), 0.0)


def objective(problem: SuiteProblem, forces: np.ndarray, moments: np.ndarray) -> np.longdouble:
    """Compute the sum of |f - s a|^2 / 2k, moments over their spin radii included, in long double."""
    normals = frame(problem).normals
    deviation = np.asarray(forces, Wide) - np.asarray(problem.squeeze, Wide)[:, None] * normals
    spins = np.asarray(moments, Wide) / or_one(np.asarray(spin_radius(problem), Wide))
    weights = np.asarray(problem.weights, Wide)
    cost = (np.sum(deviation**2, -1) + spins**2) / (2 * or_one(weights))
    return np.sum(np.where(weights > 0, cost, 0))
