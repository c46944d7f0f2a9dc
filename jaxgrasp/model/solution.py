"""The methods of force distribution that are compared, and what a method answers: forces, and a verdict of their worth.

Four methods are compared, each closed form with its own optimum. Comparing A with B would compare two objectives; a
closed form is a relaxation of its own optimum, and the difference between the two is the price of friction.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import jax
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Batched, Float, Int


class Verdict(IntEnum):
    """The outcome of one problem. The codes are stable in files.

    ``solution.verdict_name`` is its name, ``solution.advice`` a sentence to act on.

    Example:
        >>> from jaxgrasp import Verdict
        >>> Verdict(3).name, Verdict(3).solved
        ('INFEASIBLE', False)
    """

    advice: str

    CLOSED_FORM_OPTIMAL = (
        0,
        "The closed form lies inside every friction cone and limit, so it is the constrained optimum.",
    )
    OPTIMAL = (
        1,
        "The constrained optimum: at least one friction cone or limit holds the forces back from the closed form.",
    )
    OUTSIDE_CONES = (
        2,
        "These forces balance the wrench, but a contact slips or pulls: "
        "use constrained_optimum for forces that friction allows.",
    )
    INFEASIBLE = (
        3,
        "No allowed forces give this wrench: the object escapes along minus the certificate. "
        "Add contacts, friction, or move contacts against that twist; where there are limits, they may be what holds.",
    )
    NO_CONTACTS = (
        4,
        "No contact can carry a force: none is present, or all sharing weights are zero (squeeze, for method B).",
    )
    NOT_CONVERGED = (
        5,
        "Neither an optimum nor a proof that there is none was found: the wrench may lie at the limit of what the "
        "contacts can exert, where forces grow very large, as they do where friction of next to nothing (below 1e-3) "
        "has to hold a torque; else look at the residual, and try float64, last_resort=True of constrained_optimum, or "
        "rescale an extreme friction or squeeze.",
    )
    INVALID_DATA = (
        6,
        "The data hold NaN, infinite or negative entries, zero normals, sharing weights of next to nothing, also "
        "beside the others (below the smallest normal number), or limits that contradict each other: "
        "run check_grasp on the grasp and check_limits on its limits, and look at the wrench.",
    )
    FEASIBLE = (
        7,
        "These forces balance the wrench inside every friction cone and limit, but rounding hides whether they are the "
        "optimum: the load is below rounding of the squeezing forces, or sharing weights lie too many orders of "
        "magnitude apart.",
    )

    def __new__(cls, code: int, advice: str = "") -> "Verdict":
        member = int.__new__(cls, code)
        member._value_ = code
        member.advice = advice
        return member

    @property
    def solved(self) -> bool:
        """True where the forces are the optimum: they balance the wrench inside every friction cone."""
        return self in (Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL)


def is_optimum(verdict: Any) -> Any:
    """Return whether a verdict, or each of an array, says that the forces are the optimum."""
    return verdict <= Verdict.OPTIMAL


def is_held(verdict: Any) -> Any:
    """Return whether verdicts say that the forces balance the wrench inside every cone, optimal or not."""
    return is_optimum(verdict) | (verdict == Verdict.FEASIBLE)


def is_balanced(verdict: Any) -> Any:
    """Return whether verdicts say that the forces balance the wrench, inside the cones or not."""
    return is_held(verdict) | (verdict == Verdict.OUTSIDE_CONES)


def verdict_names(codes: Any) -> Any:
    """Return the name of a verdict's code; of an array of codes an array of names of the same shape."""
    names = np.array([verdict.name for verdict in Verdict])[np.asarray(codes)]
    return names if names.ndim else str(names)


class Route(IntEnum):
    """The phase that answered a problem, and so the cost of the answer. The codes are stable in files."""

    CLOSED_FORM = 0
    """A closed form; for an optimum, the solve was skipped."""
    NEWTON = 1
    """Newton's method on the dual, with gathered problems."""
    ROBUST = 2
    """Principal axes, whitened coordinates, and for an optimum a proximal term."""
    GIVEN = 3
    """A solver that the user gave."""


class Solution(Batched):
    """Contact forces and how good they are, for one problem or a batch; ``print`` shows a summary.

    ``len(solutions)`` counts along the first batch axis; ``solutions[3]``, a slice or a mask take some.

    Differentiate its fields (``forces``, ``moments``, ``multiplier``, ``objective``), not the whole: ``verdict``,
    ``steps``, ``route`` and ``rank`` are integers. What is zero for every answer (``residual``, ``certificate``,
    ``force_bound``) has a derivative of zero. Where there is no answer, as for INFEASIBLE, there is no derivative: it
    is NaN in whatever asks for it. A loss that leaves such problems out by ``jnp.where`` stays finite.
    """

    last_axes: ClassVar[dict[str, int]] = {
        **dict.fromkeys(("verdict", "residual", "objective", "steps", "route", "rank", "force_bound"), 0),
        **dict.fromkeys(("multiplier", "certificate", "moments"), 1),
        **dict.fromkeys(("normal_multiplier", "torque_multiplier", "certificate_rates"), 1),
        "forces": 2,
    }

    forces: Float[Array, "*batch n 3"]
    """What the hand exerts on the object at each contact [N]. They balance the wrench where the verdict is one of the
    first three, or FEASIBLE; for INFEASIBLE and NOT_CONVERGED they are where the solver stopped, and do not."""
    multiplier: Float[Array, "*batch 6"]
    """Lagrange multiplier of G f = w about the frame's origin (eq. 8); of minimal norm, in the grasp's own
    centred and scaled coordinates, where it is not unique."""
    verdict: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.Verdict`][]; ``verdict_name`` is its name."""
    residual: Float[Array, "*batch"]
    """What the forces miss of the wrench, as a part of it: |G f - w| / |w|, in the grasp's own centred and scaled
    coordinates. Where the forces are so much larger than the wrench that their own rounding hides it, a small part of
    the forces stands in place of |w|. An answer of more than 7.5e-9 (in float32 1.7e-4) is not called sound. The
    unit of length is the contacts' distance from their centre. Contacts that all lie at one point have none: their
    torques are measured by that point's distance from the frame's origin, or 1 m at the origin. At 1 m and 1 N, a
    torque of 7.5e-9 N.m about the point, which no hard finger there can exert, still counts as balanced."""
    objective: Float[Array, "*batch"]
    """F_2 (eq. 5) or F_3 (eq. 13), by the sharing weights; contacts of zero weight add nothing. The moment m of a soft
    finger counts as a force of mu m / gamma, which uses as much friction. For NOT_CONVERGED a lower bound of it."""
    steps: Int[Array, "*batch"]
    """Newton steps taken; 0 where the closed form was already optimal."""
    route: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.Route`][]: the pass that answered."""
    rank: Int[Array, "*batch"]
    """Rank of the weighted grasp matrix: directions of wrench that the contacts reach, at most 6."""
    certificate: Float[Array, "*batch 6"]
    """For INFEASIBLE and NO_CONTACTS: d = (linear, angular) about the frame's origin with w.d > 0 while no
    contact can push along it; the object escapes along -d. Zero otherwise."""
    force_bound: Float[Array, "*batch"]
    """For INFEASIBLE, what the certificate proves: any allowed forces of this wrench would have normal components of
    at least so much in all [N], over the contacts that no limit bounds. In float64 it is at least 4.6e5 times the
    load, in float32 20 times: what lies beyond is not excluded. Zero for other verdicts."""
    # Where the problem has no such thing, there is no field to fill.
    moments: Float[Array, "*batch n"] | None = None
    """What soft fingers exert about their normals [N.m]; ``None`` where the grasp has no torsion."""
    normal_multiplier: Float[Array, "*batch n"] | None = None
    """Which bounds of the normal forces bind, and what they cost: positive at an upper one, negative at a lower one,
    zero where none binds [units of the multiplier]; ``None`` where no normal force is limited. It says nothing where
    no forces exist, nor does the next."""
    torque_multiplier: Float[Array, "*batch j"] | None = None
    """Which limits of the joints' torques bind, and what they cost: positive where a positive torque is at its limit,
    negative where a negative one is, zero where none binds [units of the multiplier]; ``None`` where no torque is
    limited."""
    certificate_rates: Float[Array, "*batch j"] | None = None
    """For INFEASIBLE with limited torques: speeds e of the joints [rad/s, or m/s], which belong to the certificate d.
    Contacts cannot push along d less what the joints move them, J e, and w.d exceeds what the joints can do,
    sum of torque_max |e|."""

    @property
    def verdict_name(self) -> Any:
        """Name of the verdict, such as ``"OPTIMAL"``; of a batch an array of names ``(*batch)``."""
        return verdict_names(self.verdict)

    @property
    def advice(self) -> str:
        """A sentence to act on, about one problem: its verdict's, and how far a proof reaches."""
        if self.batch_shape:
            raise ValueError(
                f"advice explains one problem, but this is a batch {self.batch_shape}: index it first, as by [0]"
            )
        verdict, bound = Verdict(int(self.verdict)), float(self.force_bound)
        if verdict == Verdict.NOT_CONVERGED and bound > 0:
            return (
                f"No allowed forces give this wrench whose normal components are less than {bound:.3g} N in all, and "
                "whether larger ones do is not decided: try float64."
            )
        if verdict == Verdict.INFEASIBLE:
            return f"{verdict.advice} Proven for forces of up to {bound:.3g} N in all."
        return verdict.advice

    def __str__(self) -> str:
        """Verdicts, the largest force and residual, and of a single problem the advice, in a few lines."""
        shown = (self.forces, self.verdict, self.residual, self.objective, self.steps, self.route, self.force_bound)
        if not all(map(is_known, shown)):
            return repr(self)
        contacts = f"{self.forces.shape[-2]} contacts"
        if not self.batch_shape:
            verdict, route = Verdict(int(self.verdict)), Route(int(self.route))
            return (
                f"Solution of {contacts}: {verdict.name}\n  {self.advice}\n"
                f"  {self._sizes()}, objective {float(self.objective):.6g}, "
                f"{int(self.steps)} Newton steps, by the pass {route.name}"
            )
        verdicts, counts = np.unique(np.asarray(self.verdict), return_counts=True)
        counts_text = ", ".join(f"{count:,} {Verdict(int(code)).name}" for code, count in zip(verdicts, counts))
        sizes = self._sizes() if counts.sum() else "nothing solved"
        return f"Solution of {int(counts.sum()):,} problems of {contacts}\n  {counts_text or 'no problems'}\n  {sizes}"

    def _sizes(self) -> str:
        """Return the largest force and residual of the problems that balance their wrench."""
        has_answer = is_balanced(np.asarray(self.verdict))
        if not has_answer.any():
            return "no forces"
        forces = np.linalg.norm(np.asarray(self.forces), axis=-1)[has_answer]
        return f"largest force {forces.max():.4g} N, residual {np.asarray(self.residual)[has_answer].max():.1e}"


def is_known(array: object) -> bool:
    """Return whether an array's numbers can be read: it is not traced, not a shape alone, not deleted, and local."""
    if isinstance(array, jax.core.Tracer):
        return False
    if isinstance(array, Array):
        return not array.is_deleted() and array.is_fully_addressable
    return isinstance(array, np.ndarray | np.generic)


@dataclass(frozen=True)
class ComparedMethod:
    """A method of distributing forces."""

    name: str
    title: str
    sharing: str
    constrained: bool


METHODS = {
    method.name: method
    for method in (
        ComparedMethod("A", "method A (eq. 11), uniform sharing", "uniform", constrained=False),
        ComparedMethod("B", "method B (eq. 15), sharing by squeeze", "squeeze", constrained=False),
        ComparedMethod("A-optimum", "constrained optimum, uniform sharing", "uniform", constrained=True),
        ComparedMethod("B-optimum", "constrained optimum, sharing by squeeze", "squeeze", constrained=True),
    )
}


def methods_named(names: tuple[str, ...]) -> tuple[ComparedMethod, ...]:
    """Return the methods of these names, each once, in the order of the table above."""
    for name in names:
        if name not in METHODS:
            raise ValueError(f"method {name!r} is unknown: expected one or more of {', '.join(METHODS)}")
    if not names:
        raise ValueError(f"methods is empty: expected one or more of {', '.join(METHODS)}")
    return tuple(method for name, method in METHODS.items() if name in names)
