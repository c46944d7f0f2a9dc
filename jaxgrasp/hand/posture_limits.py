"""Joint limits, bad poses and bad starts: refused with their names, or clamped, as the caller likes.

Joint torques of a hand as limits of the forces of a grip.
"""

import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.kinematics import contact_jacobian, flatten_posture, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import entries
from jaxgrasp.model.grasp import Limits
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.geometry import is_rotation
from jaxgrasp.validation.checked import checked

ROUNDING = 1e-6
"""Tolerance for rounding: of an angle beyond its limit [rad], and of a rotation's orthonormality."""


@checked
def check_posture(hand: Hand, posture: Posture) -> None:
    """Raise ValueError at the first entry of concrete postures that no such hand can take.

    Args:
        hand: whose limits hold.
        posture: with any leading axes.

    Raises:
        ValueError: for angles that are not finite or beyond their limits, and for a wrist that is no pose.
    """
    check_pose("wrist", posture.wrist)
    flatten_posture(hand, posture)  # for the errors that shapes deserve
    angles = np.asarray(posture.angles)
    lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
    bad = np.argwhere(~((angles >= lower - ROUNDING) & (angles <= upper + ROUNDING)))
    if len(bad):
        at = tuple(int(i) for i in bad[0])
        joint = at[-1]
        raise ValueError(
            f"angles[{', '.join(map(str, at))}] ({hand.joints[joint]}) is {angles[at]:.6g} rad: "
            f"expected {lower[joint]:.6g} to {upper[joint]:.6g}; clamp_posture brings it there"
        )


@checked
def check_pose(name: str, pose: Pose) -> None:
    """Raise ValueError unless origins are finite and rotations are rotations."""
    origin, rotation = np.asarray(pose.origin), np.asarray(pose.rotation)
    for fault in entries(f"{name}.origin", origin, ~np.isfinite(origin), "a finite number [m]"):
        raise ValueError(str(fault))
    bad = np.argwhere(~is_rotation(rotation, ROUNDING))
    if len(bad):
        index = ", ".join(map(str, bad[0]))
        raise ValueError(
            f"{name}.rotation{f'[{index}]' if index else ''} is not a rotation: expected a matrix with orthonormal "
            "columns and determinant 1"
        )


@checked
def clamp_posture(hand: Hand, posture: Posture) -> Posture:
    """Return the posture with every angle brought within its limits; what is not a number stays.

    Joints that follow others (``Hand.coupling``) are put where the law has them.
    """
    angles = jnp.clip(jnp.asarray(posture.angles), hand.lower, hand.upper)
    return Posture(posture.wrist, angles if hand.coupling is None else hand.coupling.angles(angles))


@checked
def check_clear(hand: Hand, posture: Posture, shape: Shape, placed: Pose, depth: float = 0.0) -> None:
    """Raise ValueError where a hand starts inside an object: closing it there says nothing.

    Args:
        hand: one for all postures.
        posture: where it starts; any leading axes.
        shape: what it is to close on.
        placed: where that stands.
        depth: that links may have from the start [m].
    """
    depths = np.asarray(find_contacts(hand, posture, shape, placed).depths)
    # A NaN is neither: it says that the data are bad.
    bad = np.argwhere(~(depths <= depth))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        prefix = f"posture[{', '.join(map(str, index[:-1]))}]: " if index[:-1] else ""
        raise ValueError(
            f"{prefix}the link {hand.links[index[-1]].name} starts {depths[index]:.3g} m inside the object: "
            f"expected at most {depth:.3g} m"
        )


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
