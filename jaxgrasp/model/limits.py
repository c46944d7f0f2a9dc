"""What a hand can exert: bounds on the normal force of each contact, and on the torques of the joints behind them."""

import equinox as eqx

from jaxgrasp.model.arrays import AnyArray, Float, Lists, from_lists

NORMALS, TORQUES = ("normal_min", "normal_max"), ("torque_map", "torque_max")
BOUNDS = (*NORMALS, *TORQUES)
"""The fields of Limits."""


class Limits(eqx.Module):
    """Bounds that forces must respect besides friction, for one grasp or a batch; ``None`` where there is none.

    The hand itself does not appear: joints are known by what the contact forces ask of them,
    torque = sum of torque_map_i^T f_i. Building them checks nothing; hand concrete ones
    to [`jaxgrasp.check_limits`][] first.
    """

    normal_min: Float[AnyArray, "*batch n"] | None
    """Least normal force of each contact >= 0 [N]: a preload."""
    normal_max: Float[AnyArray, "*batch n"] | None
    """Largest normal force of each contact [N], no smaller than the least; inf where there is none."""
    torque_map: Float[AnyArray, "*batch n c j"] | None
    """Contact Jacobians [m/rad, or 1 for joints that slide]: velocity of the contact by the speed of each joint, as
    [`jaxgrasp.hand.contact_jacobian`][] gives it; c is 3, or 4 with a last row for the speed of turning about the
    normal, which the moments of soft fingers work on [1]."""
    torque_max: Float[AnyArray, "*batch j"] | None
    """Largest torque of each joint, in either direction, >= 0 [N.m, or N]; inf where there is none."""

    # Rather than converters of the fields, whose shapes would go unchecked.
    def __init__(
        self,
        *,
        normal_min: Float[AnyArray, "*batch n"] | Lists | None = None,
        normal_max: Float[AnyArray, "*batch n"] | Lists | None = None,
        torque_map: Float[AnyArray, "*batch n c j"] | Lists | None = None,
        torque_max: Float[AnyArray, "*batch j"] | Lists | None = None,
    ):
        self.normal_min = from_lists("normal_min", normal_min)
        self.normal_max = from_lists("normal_max", normal_max)
        self.torque_map = from_lists("torque_map", torque_map)
        self.torque_max = from_lists("torque_max", torque_max)
