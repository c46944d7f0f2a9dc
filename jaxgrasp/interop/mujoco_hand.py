"""A robot's or a muscle model's hand out of MuJoCo: the same hinges, its collision geoms as spheres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from jaxgrasp.interop.model_file import LeftOut
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.interop.mujoco_couplings import couplings, largest_torques, tightened_limits
from jaxgrasp.model.hand import Coupling, Hand, Link, padded
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

LEAVES = 12
"""The most spheres along a geom."""


@dataclass(frozen=True)
class MujocoHand:
    """A Hand, and where its parts are in the model that it came from."""

    hand: Hand
    model: mujoco.MjModel
    addresses: np.ndarray
    """``(J,)``: of each joint's angle in ``data.qpos``."""
    velocities: np.ndarray
    """``(J,)``: of each joint's rate in ``data.qvel``, and of its column in MuJoCo's Jacobians."""
    bodies: np.ndarray
    """``(L,)``: id of each link's body."""
    positions: np.ndarray
    """``(L, 3)``: of the body's frame in the link's [m]."""
    rotations: np.ndarray
    """``(L, 3, 3)``: of the body's frame in the link's."""
    left_out: tuple[str, ...]
    """Collision geoms that are no sphere, capsule, cylinder, ellipsoid or box, and so touch nothing here; of a URDF
    that was read with ``keep_going``, links' meshes that are missing too."""
    coupled: tuple[LeftOut, ...] = ()
    """Couplings of joints that are not in the Hand's: not linear, loose, or with joints that are not the hand's."""


@dataclass
class _CarryingJoint:
    """A body's frame in that of the joint that carries it."""

    joint: int
    position: np.ndarray
    rotation: np.ndarray

    def carry(self, position: np.ndarray, rotation: np.ndarray) -> _CarryingJoint:
        """Express a frame, given in this body's frame, in that of the carrying joint."""
        return _CarryingJoint(self.joint, self.position + self.rotation @ position, self.rotation @ rotation)


@checked
def hand_from_mujoco(
    model: mujoco.MjModel,
    wrist: str,
    *,
    locked: Mapping[str, float] | None = None,
    names: Mapping[str, tuple[str, str]] | None = None,
) -> MujocoHand:
    """Build the hand that hangs on a body of a MuJoCo model (MJCF or URDF).

    Args:
        model: the compiled model.
        wrist: name of the body that is the wrist; its frame is the Hand's, its own joints are not the Hand's.
        locked: joints that stay at an angle [rad] or a place [m], by name.
        names: finger and phalanx of a body, by its name, such as ``{"2proxph_r": ("index", "proximal")}``; others
            are called by their own name, and ``""``.

    Returns:
        The Hand: every joint below the wrist that is not locked, and a link for every body with collision geoms.
        Its largest torques are those of the motors, as far as the model limits them. Joints that follow others by
        URDF's ``mimic``, a linear equality, or a fixed tendon whose range is a tenth of its way at most, are the
        Hand's ``coupling``; limits of the joints that they follow are such that none passes its own.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for a name that the model lacks, a joint that neither turns nor slides, or a body that
            carries no hand.
    """
    mujoco = import_mujoco("hand_from_mujoco")
    locked = dict(locked or {})
    root = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, wrist)
    if root < 0:
        raise ValueError(f"wrist is {wrist!r}: the model has no body of that name")
    for name in locked:
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) < 0:
            raise ValueError(f"locked names {name!r}: the model has no joint of that name")
    tree = _Tree(mujoco, model, locked)
    carriers = {root: _CarryingJoint(-1, np.zeros(3), np.eye(3))}
    for body in range(root + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent in carriers:
            frame = carriers[parent].carry(model.body_pos[body], _matrix(mujoco, model.body_quat[body]))
            carriers[body] = tree.add_joints(body, frame)
    return _finish(mujoco, model, tree, carriers, dict(names or {}))


class _Tree:
    """Joints as they are met."""

    def __init__(self, mujoco: Any, model: mujoco.MjModel, locked: dict[str, float]):
        self.mujoco, self.model, self.locked = mujoco, model, locked
        self.joints: list[int] = []
        self.parents: list[int] = []
        self.origins: list[np.ndarray] = []
        self.rests: list[np.ndarray] = []

    def add_joints(self, body: int, frame: _CarryingJoint) -> _CarryingJoint:
        """Add the body's joints, and return the body's frame in that of its last joint."""
        first = int(self.model.body_jntadr[body])
        for joint in range(first, first + int(self.model.body_jntnum[body])):
            frame = self._add(joint, frame)
        return frame

    def _add(self, joint: int, frame: _CarryingJoint) -> _CarryingJoint:
        model, name = self.model, self.model.joint(joint).name
        anchor, axis = model.jnt_pos[joint], model.jnt_axis[joint]
        types = self.mujoco.mjtJoint
        hinge, slide = (model.jnt_type[joint] == type_ for type_ in (types.mjJNT_HINGE, types.mjJNT_SLIDE))
        if not (hinge or slide):
            raise ValueError(f"joint {name!r} neither turns about an axis nor slides along one: a Hand's joints do")
        # MuJoCo turns from the angle that the joint has in the reference configuration.
        reference = model.qpos0[model.jnt_qposadr[joint]]
        if name in self.locked:
            displacement = self.locked[name] - reference
            if hinge:
                turn = _turn(self.mujoco, axis, displacement)
                return frame.carry(anchor - turn @ anchor, turn)
            return frame.carry(displacement * axis, np.eye(3))
        joint_frame = frame.carry(anchor, np.eye(3))
        self.joints.append(joint)
        self.parents.append(joint_frame.joint)
        self.origins.append(joint_frame.position)
        self.rests.append(joint_frame.rotation)
        if slide:
            return _CarryingJoint(len(self.joints) - 1, -reference * axis - anchor, np.eye(3))
        back = _turn(self.mujoco, axis, -reference)
        return _CarryingJoint(len(self.joints) - 1, -back @ anchor, back)


def _finish(
    mujoco: Any, model: mujoco.MjModel, tree: _Tree, carriers: dict[int, _CarryingJoint], names: dict
) -> MujocoHand:
    links, spheres, bodies, left_out = [], [], [], []
    for body, frame in carriers.items():
        first = int(model.body_geomadr[body])
        geoms = [g for g in range(first, first + int(model.body_geomnum[body])) if collides(model, g)]
        parts = []
        for geom in geoms:
            row = _spheres(mujoco, model, geom, frame)
            if row is None:
                left_out.append(model.geom(geom).name or f"geom {geom}")
            else:
                parts.append(row)
        if parts:
            name = model.body(body).name
            finger, phalanx = names.get(name, (name, ""))
            links.append(Link(finger, phalanx, frame.joint))
            spheres.append((np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])))
            bodies.append(body)
    if not tree.joints or not links:
        raise ValueError("no joint, or no geom that can touch, hangs on the wrist's body: is it the right one?")
    joints = np.array(tree.joints, int)
    slides = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
    # Limits that the model does not have are a whole turn.
    limits = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], [-np.pi, np.pi])
    law, not_coupled = couplings(mujoco, model, tree.joints, tree.locked)
    limits = tightened_limits(law, limits)
    torque_max = largest_torques(mujoco, model, joints, law)
    is_coupled = len(law.independent) < len(joints)
    hand = Hand(
        jnp.array(tree.origins),
        jnp.array(tree.rests),
        jnp.array(model.jnt_axis[joints]),
        jnp.array(limits[:, 0]),
        jnp.array(limits[:, 1]),
        padded(spheres),
        tuple(tree.parents),
        tuple(model.joint(j).name for j in joints),
        tuple(links),
        tuple(model.joint(j).name for j in joints[slides]),
        None if np.isinf(torque_max).all() else jnp.array(torque_max),
        Coupling(jnp.array(law.matrix), jnp.array(law.offset), tuple(law.independent.tolist())) if is_coupled else None,
    )
    return MujocoHand(
        hand=hand,
        model=model,
        addresses=model.jnt_qposadr[joints].copy(),
        velocities=model.jnt_dofadr[joints].copy(),
        bodies=np.array(bodies, int),
        positions=np.array([carriers[body].position for body in bodies]),
        rotations=np.array([carriers[body].rotation for body in bodies]),
        left_out=tuple(left_out),
        coupled=not_coupled,
    )


def collides(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _spheres(
    mujoco: Any, model: mujoco.MjModel, geom: int, frame: _CarryingJoint
) -> tuple[np.ndarray, np.ndarray] | None:
    """Place spheres inside a geom, along its longest side or all over a box, in the link's frame; else None."""
    kinds = mujoco.mjtGeom
    # Converted to MuJoCo's own type, which never compares equal to a NumPy number.
    size, shape = model.geom_size[geom], kinds(model.geom_type[geom])
    if shape == kinds.mjGEOM_SPHERE:
        centers, radii = np.zeros((1, 3)), np.array([size[0]])
    elif shape == kinds.mjGEOM_CAPSULE:
        centers, radii = _row(2, size[1]), np.full(LEAVES, size[0])
    elif shape == kinds.mjGEOM_CYLINDER:
        centers, radii = _row(2, max(size[1] - size[0], 0)), np.full(LEAVES, min(size[0], size[1]))
    elif shape == kinds.mjGEOM_BOX:
        centers = _filled(size)
        radii = np.full(len(centers), size.min())
    elif shape == kinds.mjGEOM_ELLIPSOID:
        order = np.argsort(size).tolist()
        thin, _, long = size[order]
        # The largest sphere about a point of the long axis that fits under the curve.
        centers = _row(order[2], long - thin**2 / long)
        offsets = centers[:, order[2]]
        radii = thin * np.sqrt(1 - offsets**2 / np.maximum(long**2 - thin**2, 1e-300))
        radii = np.where(offsets == 0, thin, radii)
    else:
        return None
    geom_frame = frame.carry(model.geom_pos[geom], _matrix(mujoco, model.geom_quat[geom]))
    return geom_frame.position + centers @ geom_frame.rotation.T, radii


def _row(axis: int, reach: float) -> np.ndarray:
    """Return evenly spaced points ``(LEAVES, 3)`` along an axis, from -reach to reach."""
    return np.linspace(-reach, reach, LEAVES)[:, None] * np.eye(3)[axis]


def _filled(size: np.ndarray) -> np.ndarray:
    """Return centres of balls as thick as a box all over it, no further apart than their radius; a bar is one row."""
    reach = size - size.min()
    counts = np.where(reach > 0, np.minimum(1 + np.ceil(2 * reach / size.min()), LEAVES), 1).astype(int)
    if np.median(reach) == 0 < reach.max():
        counts[size.argmax()] = LEAVES
    axes = [np.linspace(-r, r, n) if n > 1 else np.zeros(1) for r, n in zip(reach, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _matrix(mujoco: Any, quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _turn(mujoco: Any, axis: np.ndarray, angle: float) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return _matrix(mujoco, quaternion)
