"""What every method of the literature answers: forces, and a status that says what they are worth."""

from enum import IntEnum

import equinox as eqx

from jaxgrasp.model.arrays import AnyArray, Float, Int


class MethodStatus(IntEnum):
    """The outcome of one problem by one method. The codes are stable in files.

    ``MethodStatus(int(answer.status)).advice`` is a sentence to act on.
    """

    advice: str

    SOLVED = 0, "These forces balance the wrench within the method's own constraints, and are best by its own measure."
    INFEASIBLE = (
        1,
        "No forces within the method's constraints give this wrench. Pyramids inside the cones, limits, or a demand to "
        "stay strictly inside the cones may be what forbids it: see whether constrained_optimum finds any.",
    )
    UNBOUNDED = (
        2,
        "The method's measure grows without end along internal forces: give limits that bound every normal force.",
    )
    NOT_CONVERGED = (
        3,
        "The method stopped before it reached an optimum or a proof that there is none: allow more steps, or rescale "
        "an extreme friction or limit.",
    )
    OUTSIDE_CONES = (
        4,
        "These forces balance the wrench, but a contact slips or pulls, and the method has no others to offer: "
        "use constrained_optimum.",
    )
    INVALID_DATA = 5, "The data hold entries that no method can use: run check_grasp on the grasp, look at the wrench."

    def __new__(cls, code: int, advice: str) -> "MethodStatus":
        member = int.__new__(cls, code)
        member._value_ = code
        member.advice = advice
        return member


class MethodAnswer(eqx.Module):
    """Contact forces by one method of the literature, for one problem or a batch, in float64."""

    forces: Float[AnyArray, "*batch n 3"]
    """What the hand exerts on the object at each contact [N]; zero where the method found none."""
    status: Int[AnyArray, "*batch"]
    """Code of a [`jaxgrasp.literature.MethodStatus`][]."""
    objective: Float[AnyArray, "*batch"]
    """The method's own measure, in its own unit, where SOLVED or OUTSIDE_CONES; else zero."""
    iterations: Int[AnyArray, "*batch"]
    """What the method itself counts: pivots of a simplex, changes of a working set, steps of a flow."""
