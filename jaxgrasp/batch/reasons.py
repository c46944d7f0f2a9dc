"""Reasons why grasps do not hold their wrenches, derived from verdicts and their infeasibility certificates."""

from dataclasses import replace
from enum import IntEnum

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.model.grasp import BOUNDS
from jaxgrasp.model.solution import METHODS, Verdict

JUDGES = ("A-optimum", "B-optimum", "A", "B")
"""Methods in the order in which they judge grasps: by uniform sharing every contact may carry a force."""


STILL = 1e-10
"""Share of the largest squared velocity of contacts below which a motion counts as free of sliding."""


class Reason(IntEnum):
    """Reason for which a grasp does not hold its wrench, or ``HOLDS``. The codes are stable in files."""

    title: str
    advice: str

    HOLDS = (0, "holds", "There are contact forces inside every friction cone and limit that give the wrench.")
    LINE = (
        1,
        "no torque about the line through its contacts",
        "All contacts lie on one line, as those of a parallel jaw do, and hard fingers resist no torque about it, "
        "however hard they squeeze. Where they press along the line, as a jaw's do, soft fingers resist it: give them "
        "torsion (--torsion 0.005). Elsewhere only a contact beside the line helps.",
    )
    POINT = (
        2,
        "no torque about its one point of contact",
        "All contacts lie at one point, about which hard fingers resist no torque. Add a contact; torsion (--torsion) "
        "helps about their normals alone.",
    )
    PULL = (
        3,
        "the contacts would have to pull",
        "The object escapes straight away from its contacts, so no friction would hold it: add contacts, or move them.",
    )
    FRICTION = (
        4,
        "friction",
        "No forces inside the friction cones give the wrench: it takes more friction, or contacts that stand better.",
    )
    LIMITS = (
        5,
        "limits of forces or torques",
        "Limits of normal forces or joint torques forbid the forces that the wrench takes. Whether friction would "
        "allow them without limits is another question: evaluate the grasps without.",
    )
    NO_CONTACTS = (6, "no contact can carry a force", Verdict.NO_CONTACTS.advice)
    SLIPS = (
        7,
        "slips or pulls by the closed form",
        "The closed form leaves a friction cone. Other forces may hold: ask for an optimum too.",
    )
    NOT_DECIDED = (8, "not decided", Verdict.NOT_CONVERGED.advice)
    INVALID_DATA = (9, "invalid data", Verdict.INVALID_DATA.advice)
    HARDER = (
        10,
        "holds if it squeezes harder",
        "There are contact forces inside every friction cone and limit that give the wrench, but together they press "
        "harder than the hand means to squeeze: the squeeze factor says how many times as hard.",
    )

    def __new__(cls, code: int, title: str = "", advice: str = "") -> "Reason":
        member = int.__new__(cls, code)
        member._value_ = code
        member.title, member.advice = title, advice
        return member


_BY_VERDICT = {
    Verdict.CLOSED_FORM_OPTIMAL: Reason.HOLDS,
    Verdict.OPTIMAL: Reason.HOLDS,
    Verdict.FEASIBLE: Reason.HOLDS,
    Verdict.OUTSIDE_CONES: Reason.SLIPS,
    Verdict.INFEASIBLE: Reason.FRICTION,
    Verdict.NO_CONTACTS: Reason.NO_CONTACTS,
    Verdict.NOT_CONVERGED: Reason.NOT_DECIDED,
    Verdict.INVALID_DATA: Reason.INVALID_DATA,
}


def judge(results: dict[str, MethodResult]) -> str:
    """Return the name of the first of ``JUDGES`` in the results: the method that decides which grasps hold."""
    return next(name for name in JUDGES if name in results)


HELD = (Reason.HOLDS, Reason.HARDER)
"""Reasons of grasps that hold, as they squeeze or if they squeeze harder."""


def reasons(
    sets: ContactSets, results: dict[str, MethodResult], squeeze_factor: np.ndarray | None = None
) -> np.ndarray:
    """Return the codes of Reason for every problem, ``(N, W)``.

    Grasps that hold only if they squeeze harder are told apart by ``squeeze_factor (N, W)``, as
    ``evaluation.squeeze_factors`` returns it.
    """
    name = judge(results)
    result, method = results[name], METHODS[name]
    codes = np.array([_BY_VERDICT[verdict] for verdict in Verdict], np.int8)[result.verdict]
    if squeeze_factor is not None:
        codes[(codes == Reason.HOLDS) & (squeeze_factor > 1)] = Reason.HARDER
    grasps, wrenches = np.nonzero(result.verdict == Verdict.INFEASIBLE)
    if not len(grasps):
        return codes
    certificate = result.certificate[grasps, wrenches]
    closed = results.get(name[0])
    if closed is not None:
        # What the closed form proves, it proves of contacts that may push and pull as they like.
        beyond = closed.verdict[grasps, wrenches] == Verdict.INFEASIBLE
        certificate = np.where(beyond[:, None], closed.certificate[grasps, wrenches], certificate)
    failing = replace(sets.rows(grasps), wrench=sets.wrench[grasps, wrenches][:, None])
    codes[grasps, wrenches] = _infeasibility_reasons(failing, certificate, method.sharing)
    return codes


def _infeasibility_reasons(sets: ContactSets, certificate: np.ndarray, sharing: str) -> np.ndarray:
    """Find the reasons ``(N,)`` of sets, a wrench each, by the contact motions of their certificates ``(N, 6)``."""
    small = float(np.finfo(certificate.dtype).eps) ** 0.5
    owner, starts = np.repeat(np.arange(len(sets)), sets.sizes), sets.offsets[:-1]
    linear, angular = certificate[owner, :3], certificate[owner, 3:]
    # Velocity of contact i by the certificate's twist d = (v, w): u_i = v + w x p_i, of size |v| + |w| |p_i| at most.
    velocity = linear + np.cross(angular, sets.points)
    reach = np.linalg.norm(sets.points, axis=1)
    size = np.linalg.norm(linear, axis=1) + np.linalg.norm(angular, axis=1) * reach
    along = np.einsum("ci,ci->c", velocity, sets.normals)
    across = np.linalg.norm(velocity - along[:, None] * sets.normals, axis=1)
    if sets.torsion is not None:
        radius = np.divide(sets.torsion, sets.friction, out=np.zeros_like(sets.torsion), where=sets.friction > 0)
        across = np.hypot(across, radius * np.einsum("ci,ci->c", angular, sets.normals))
    carries = _carries(sets, sharing)
    across_only = np.logical_and.reduceat(~carries | (across <= small * size), starts)
    at_rest = across_only & np.logical_and.reduceat(~carries | (np.abs(along) <= small * size), starts)
    # Power per normal force at the cone's edge: u_i.n_i + mu_i |u_i - (u_i.n_i) n_i|; above 0 only a limit stops it.
    pushes = np.logical_or.reduceat(carries & (along + sets.friction * across > small * size), starts)
    limited = any(getattr(sets, name) is not None for name in BOUNDS)
    middle = _middle(sets, carries)
    from_middle = np.where(carries, np.linalg.norm(sets.points - middle[owner], axis=1), 0)
    apart = np.maximum.reduceat(from_middle, starts) > small * np.maximum.reduceat(reach, starts)
    # A proof may use friction where another one would do without.
    slides = ~across_only
    across_only[slides] = _escapes_straight(sets.rows(np.flatnonzero(slides)), sharing)
    why = np.where(across_only, Reason.PULL, Reason.FRICTION)
    why = np.where(at_rest, np.where(apart, Reason.LINE, Reason.POINT), why)
    return np.where(limited & pushes & ~(slides & across_only), Reason.LIMITS, why).astype(np.int8)


def _carries(sets: ContactSets, sharing: str) -> np.ndarray:
    """Return a mask ``(M,)`` of the contacts that may carry a force."""
    return np.ones(len(sets.points), bool) if sharing == "uniform" else sets.squeeze > 0


def _middle(sets: ContactSets, carries: np.ndarray) -> np.ndarray:
    """Compute the mean of each set's contacts that carry a force ``(N, 3)``."""
    starts = sets.offsets[:-1]
    count = np.add.reduceat(carries.astype(float), starts)
    return np.add.reduceat(sets.points * carries[:, None], starts) / np.maximum(count, 1)[:, None]


def _escapes_straight(sets: ContactSets, sharing: str) -> np.ndarray:
    """Return a mask ``(N,)`` of sets whose load drives a motion that takes the object straight away from its contacts.

    Such a motion slides along no contact, so that no friction resists it (Farkas: of the motions z that slide nowhere,
    those with A z <= 0 at all contacts do no work against the load c exactly where c = A^T y with y >= 0).
    """
    if not len(sets):
        return np.zeros(0, bool)
    # Here, since it takes longer to load than all else that a worker loads, and most batches have no such grasp.
    from scipy.optimize import nnls

    carries = _carries(sets, sharing)
    owner, starts = np.repeat(np.arange(len(sets)), sets.sizes), sets.offsets[:-1]
    middle = _middle(sets, carries)
    arms = sets.points - middle[owner]
    reach = np.maximum.reduceat(np.where(carries, np.linalg.norm(arms, axis=1), 0), starts)
    unit = np.where(reach > 0, reach, 1.0)
    arms = (arms / unit[owner, None]).astype(float)
    normals = sets.normals.astype(float)
    # Velocities of the contacts ``(M, 3, 6)`` for motions about the middle, turns times the reach.
    turning = np.zeros((len(owner), 3, 3))
    x, y, z = arms.T
    turning[:, 0, 1], turning[:, 0, 2], turning[:, 1, 2] = z, -y, x
    turning -= turning.transpose(0, 2, 1)
    velocity = np.concatenate([np.broadcast_to(np.eye(3), turning.shape), turning], 2)
    away = np.einsum("ci,cij->cj", normals, velocity)
    slides = velocity - normals[:, :, None] * away[:, None]
    squares = np.einsum("cij,cik->cjk", slides, slides) * carries[:, None, None]
    if sets.torsion is not None:
        squares[:, 3:, 3:] += (carries & (sets.torsion > 0))[:, None, None] * normals[:, :, None] * normals[:, None]
    sizes, motions = np.linalg.eigh(np.add.reduceat(squares, starts))
    free = sizes <= STILL * np.maximum(sizes[:, -1:], 1)
    force = sets.wrench[:, 0, :3].astype(float)
    torque = (sets.wrench[:, 0, 3:] - np.cross(middle, force)) / unit[:, None]
    load = np.concatenate([force, torque], 1)
    escapes = np.zeros(len(sets), bool)
    for k in np.flatnonzero(free.any(1)):
        basis, contacts = motions[k][:, free[k]], slice(sets.offsets[k], sets.offsets[k + 1])
        at_contacts = away[contacts][carries[contacts]] @ basis
        _, residual = nnls(at_contacts.T, basis.T @ load[k])
        escapes[k] = residual > STILL**0.5 * np.linalg.norm(load[k])
    return escapes
