"""Forces back to the person: what the robot's hand feels, shared over the person's fingers by eq. 16.

The measured wrench of the hand on the object is split over the person's contacts, which are those of the robot by
finger and phalanx; the measured normal forces are the squeezing forces s_i of eq. 6. The joint torques follow by the
Jacobian of the person's hand, and the glove's torques are those against flexion, from zero to its limits.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.hand.kinematics import ancestry, pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.teleop.follower import FollowerState
from jaxgrasp.validation.checked import checked

MIN_NORMAL_FORCE = 1e-3
"""Sum of a link's normal forces below which it counts as not touching [N]."""


class LinkLoads(NamedTuple):
    """Contacts of each of the person's L links, in the axes of the person's wrist."""

    normals: Float[np.ndarray, "L 3"]
    """Mean normals into the object; (1, 0, 0) where nothing touches."""
    squeeze: Float[np.ndarray, "L"]
    """Sums of the measured normal forces [N]; zero where nothing touches."""
    centre: Float[np.ndarray, "3"]
    """Object's centre of mass from the squeeze-weighted mean of the contacts [m]."""
    wrench: Float[np.ndarray, "6"]
    """Wrench of the hand on the object about its centre [N, N.m]."""


class ForceFeedback:
    """Map from a follower's measurements to torques of a glove."""

    def __init__(
        self, person: Hand, model: GloveModel, robot: Hand, axes: Float[np.ndarray, "3 3"], scale: float = 1.0
    ) -> None:
        """Match the links of both hands by name.

        Args:
            person: human hand in the glove.
            model: of the glove.
            robot: the follower's hand, named as by [`jaxgrasp.hand.name_fingers`][].
            axes: the person's wrist axes in the frame of the robot's palm, as columns, as a
                [`jaxgrasp.teleop.retarget.Calibration`][] has them.
            scale: of all forces, more than 0: less than 1 where the robot presses harder than the glove can resist.

        Raises:
            ValueError: for a hand without one of the glove's joints, and robots of which no link has a counterpart,
                and a scale that is not positive.
        """
        if not (np.isfinite(scale) and scale > 0):
            raise ValueError(f"scale is {scale}: expected a positive number")
        names = [link.name for link in person.links]
        self._link_of_robot = np.array([names.index(k.name) if k.name in names else -1 for k in robot.links])
        if not (self._link_of_robot >= 0).any():
            raise ValueError(f"robot has no link of a name that the person's hand has, such as {', '.join(names[:3])}")
        self.left_out = tuple(link.name for link, k in zip(robot.links, self._link_of_robot, strict=True) if k < 0)
        """Links of the robot without a counterpart, whose forces no finger feels."""
        self.person, self.model, self._axes = person, model, np.asarray(axes)
        self._transmission = model.transmission(person.joints)
        self._limits, self._scale = np.array(model.limits), scale
        self._pads = _pads(person)
        self._moves = ancestry(person).T.astype(float)
        self._posed: tuple[np.ndarray, tuple[np.ndarray, ...]] | None = None

        def frames(angles: AnyArray) -> tuple[AnyArray, ...]:
            posed = pose_hand(person, Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles))
            return posed.links.origin, posed.links.rotation, posed.joints.origin, posed.axes

        self._program = jax.jit(frames)
        # Compiled before the first touch, for which a glove would not wait.
        self.torques_of(
            LinkLoads(np.tile([1.0, 0, 0], (len(names), 1)), np.ones(len(names)), np.zeros(3), np.zeros(6)),
            np.zeros(len(person.joints)),
        )

    def loads(self, state: FollowerState) -> LinkLoads:
        """Reduce a follower's contacts to one of each of the person's links."""
        contacts, count = state.contacts, len(self.person.links)
        squeeze, normals = np.zeros(count), np.zeros((count, 3))
        links = self._link_of_robot[contacts.links] if len(contacts.links) else np.zeros(0, int)
        is_felt = links >= 0
        links = links[is_felt]
        points, forces = contacts.points[is_felt], contacts.forces[is_felt]
        # Into the person's axes: R_person = R_palm axes
        rotation = state.palm.rotation @ self._axes
        normal_forces = np.maximum(np.sum(contacts.normals[is_felt] * forces, -1), 0.0)
        np.add.at(squeeze, links, normal_forces)
        np.add.at(normals, links, normal_forces[:, None] * (contacts.normals[is_felt] @ rotation))
        lengths = np.linalg.norm(normals, axis=-1)
        is_touching = (squeeze > MIN_NORMAL_FORCE) & (lengths > 0)
        normals = np.where(is_touching[:, None], normals / np.where(is_touching, lengths, 1.0)[:, None], [1.0, 0, 0])
        squeeze = np.where(is_touching, squeeze, 0.0)
        if not is_touching.any():
            return LinkLoads(normals, squeeze, np.zeros(3), np.zeros(6))
        mean = normal_forces @ points / normal_forces.sum()
        moment = np.cross(points - state.object_centre, forces).sum(0)
        wrench = np.concatenate([forces.sum(0) @ rotation, moment @ rotation])
        return LinkLoads(normals, squeeze, (state.object_centre - mean) @ rotation, wrench)

    def torques(
        self, state: FollowerState, person_angles: Float[np.ndarray, "P"], wrench: Float[np.ndarray, "6"] | None = None
    ) -> Float[np.ndarray, "channels"]:
        """Compute the glove's torques against flexion [N.m], from 0 to its limits.

        Args:
            state: measurements of the robot.
            person_angles: of the person's joints [rad].
            wrench: that the person is to feel, about the object's centre in the person's axes [N, N.m]; the measured
                one where not given.
        """
        return np.clip(self.asked_torques(state, person_angles, wrench), 0.0, self._limits)

    def asked_torques(
        self, state: FollowerState, person_angles: Float[np.ndarray, "P"], wrench: Float[np.ndarray, "6"] | None = None
    ) -> Float[np.ndarray, "channels"]:
        """Compute the torques of ``torques``, with the same arguments, before the glove's limits [N.m]."""
        loads = self.loads(state)
        if not loads.squeeze.any():
            return np.zeros(len(self._limits))
        if wrench is not None:
            loads = loads._replace(wrench=wrench)
        return self.torques_of(loads, person_angles)

    def forces(
        self, loads: LinkLoads, person_angles: Float[np.ndarray, "P"]
    ) -> tuple[Float[np.ndarray, "L 3"], Float[np.ndarray, "L 3"]]:
        """Compute the contact points ``(L, 3)`` [m] and the forces on the object there ``(L, 3)`` [N], by eq. 16."""
        points = self.contact_points(loads.normals, person_angles)
        total = loads.squeeze.sum()
        mean = loads.squeeze @ points / max(total, MIN_NORMAL_FORCE)
        # About the object's centre, where the wrench is taken.
        return points, shared_forces(points - (mean + loads.centre), loads.normals, loads.squeeze, loads.wrench)

    def contact_points(
        self, normals: Float[np.ndarray, "L 3"], person_angles: Float[np.ndarray, "P"]
    ) -> Float[np.ndarray, "L 3"]:
        """Compute where each link's pad meets a surface of these normals, in the wrist's frame ``(L, 3)`` [m]."""
        origins, rotations, _, _ = self._frames(person_angles)
        centers, radii = self._pads
        return origins + (rotations @ centers[..., None])[..., 0] + radii[:, None] * normals

    def torques_of(self, loads: LinkLoads, person_angles: Float[np.ndarray, "P"]) -> Float[np.ndarray, "channels"]:
        """Compute the scaled torques against flexion for given loads, before the glove's limits [N.m]."""
        points, forces = self.forces(loads, person_angles)
        _, _, joint_origins, axes = self._frames(person_angles)
        # tau_j = sum over the links that j moves of z_j . ((p - o_j) x (-f))
        moments = np.cross(points, forces)
        total, moment = self._moves @ forces, self._moves @ moments
        torques = -np.sum(axes * (moment - np.cross(joint_origins, total)), -1)
        return -self._scale * (self._transmission @ torques)

    def _frames(self, person_angles: Float[np.ndarray, "P"]) -> tuple[np.ndarray, ...]:
        """Return origins and rotations of the links, origins and axes of the joints, in the wrist's frame."""
        if self._posed is None or not np.array_equal(self._posed[0], person_angles):
            self._posed = np.array(person_angles), tuple(map(np.asarray, self._program(person_angles)))
        return self._posed[1]


@checked
def shared_forces(
    arms: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    squeeze: Float[np.ndarray, "n"],
    wrench: Float[np.ndarray, "6"],
) -> Float[np.ndarray, "n 3"]:
    """Compute the forces of eq. 16 for one grasp, f = s a + W G' (G W G')^+ (w - G s a) with W = diag(s), in NumPy.

    The forces are those of [`jaxgrasp.closed_form`][], of which a call takes many times as long for one small grasp.

    Args:
        arms: contact points from the point about which the wrench is taken [m].
        normals: into the object.
        squeeze: s, zero where nothing touches [N].
        wrench: of the contacts on the object [N, N.m].
    """
    pressing = squeeze[:, None] * normals
    residual = wrench - np.concatenate([pressing.sum(0), np.cross(arms, pressing).sum(0)])
    cross = np.zeros((len(arms), 3, 3))
    cross[:, [1, 2, 0], [2, 0, 1]], cross[:, [2, 0, 1], [1, 2, 0]] = -arms[:, [0, 1, 2]], arms[:, [0, 1, 2]]
    blocks = np.concatenate([np.broadcast_to(np.eye(3), cross.shape), cross], 1)
    # Lengths are scaled by the contacts' distance, so that the rank is judged without units.
    size = np.sqrt(squeeze @ np.sum(arms**2, -1) / max(squeeze.sum(), MIN_NORMAL_FORCE)) or 1.0
    unit = np.array([1.0] * 3 + [1 / size] * 3)
    scaled = unit[:, None] * blocks
    weighted = np.einsum("nij,n,nkj->ik", scaled, squeeze, scaled)
    multiplier = np.linalg.pinv(weighted, rcond=1e-9, hermitian=True) @ (unit * residual)
    return pressing + squeeze[:, None] * (np.swapaxes(scaled, 1, 2) @ multiplier)


def _pads(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and radius of the ball that touches, of each link: the last of a distal one, else the middle."""
    centers, radii = np.asarray(hand.skin.centers), np.asarray(hand.skin.radii)
    counts, links = np.sum(radii > 0, -1), np.arange(len(radii))
    is_distal = np.array([link.phalanx == "distal" for link in hand.links])
    rows = np.where(is_distal, counts - 1, counts // 2)
    return centers[links, rows], radii[links, rows]
