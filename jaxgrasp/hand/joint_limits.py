"""Joint torques of a hand as limits of the forces of a grip."""

import jax.numpy as jnp

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.kinematics import contact_jacobian, pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Posture
from jaxgrasp.model.limits import Limits
from jaxgrasp.validation.checked import checked


@checked
def torque_limits(
    hand: Hand, posture: Posture, contacts: Contacts, torque_max: Float[AnyArray, "J"] | None = None
) -> Limits:
    """Return the limits that a hand's joints set to the forces of a posture's contacts.

    The torques are those that the contact forces put on the joints, without the weight of the hand's own links.
    Where joints follow others (``Hand.coupling``), the limits are those of the I independent joints: a motor holds the
    torques of all joints that it moves, by the transposed coupling matrix.

    Args:
        hand: whose joints hold.
        posture: any leading axes.
        contacts: of that posture, in the world, one for each link.
        torque_max: of each joint [N.m, or N of those that slide], inf where there is none; the hand's own where not
            given. Entries of joints that follow others do not count.

    Returns:
        For [`jaxgrasp.constrained_optimum`][] and its like, of the grasp that
        [`jaxgrasp.hand.grasp_from_contacts`][] makes of the same contacts.

    Raises:
        ValueError: where neither the hand nor the caller says how strong its joints are.
    """
    largest, count = hand.torque_max if torque_max is None else torque_max, len(hand.joints)
    if largest is None:
        raise ValueError("torque_max is None and the hand has no torque limits: expected a torque for each joint")
    if jnp.shape(largest) != (count,):
        raise ValueError(f"torque_max has shape {jnp.shape(largest)}: expected ({count},), one for each joint")
    jacobian = contact_jacobian(hand, pose_hand(hand, posture), contacts.points)
    bounds = jnp.asarray(largest, jacobian.dtype)
    if hand.coupling is not None:
        jacobian, bounds = hand.coupling.torques(jacobian), bounds[jnp.asarray(hand.coupling.independent)]
    return Limits(torque_map=jacobian, torque_max=jnp.broadcast_to(bounds, (*jacobian.shape[:-3], *bounds.shape)))
