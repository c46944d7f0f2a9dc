"""A simulated follower: a robot hand out of an MJCF file on an arm of six motors, in MuJoCo (extra ``hands``).

Joints are controlled by position; their forces are limited as the file says. The arm carries the palm by three sliding
and three turning motors, whose stiffness and largest force are those of a compliant arm.
"""

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxgrasp.hand.closing import name_fingers
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.interop.mujoco_hand import hand_from_mujoco
from jaxgrasp.teleop.follower import (
    MAX_SILENCE,
    Follower,
    FollowerContacts,
    FollowerState,
    PalmPose,
    check_command,
)
from jaxgrasp.validation.checked import checked

TIMESTEP = 2e-3
"""Step of the simulation [s]: 500 Hz."""
ARM_JOINTS = ("arm x", "arm y", "arm z", "arm roll", "arm pitch", "arm yaw")
ARM_STIFFNESS = (800.0,) * 3 + (40.0,) * 3
"""Stiffness of the arm's control [N/m, N.m/rad]."""
ARM_DAMPING = (60.0,) * 3 + (2.0,) * 3
"""[N.s/m, N.m.s/rad]"""
ARM_LIMITS = (40.0,) * 3 + (6.0,) * 3
"""Largest force and torque of the arm [N, N.m]."""
ARM_ARMATURE = (1.5,) * 3 + (0.02,) * 3
"""Apparent inertia of the arm [kg, kg.m2]."""
PREFIX = "robot:"
"""Before the names of arm and hand."""
FINGER_DAMPING = 0.05
"""Least damping of a finger's joint [N.m.s/rad]."""


@dataclass(frozen=True)
class HandModel:
    """An MJCF file of a robot hand, and its parts that matter here."""

    path: Path
    wrist: str
    """Name of the body that the arm carries: the palm. Its own joints are taken away."""
    names: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Finger and phalanx of links whose names do not say it, as for [`jaxgrasp.hand.name_fingers`][]."""
    gain: float = 1.0
    """Factor on the stiffness of the file's position control; force limits stay."""
    force_limit: float = 1.0
    """Largest torque of motors that the file does not limit [N.m]."""


@checked
def shadow_hand() -> HandModel:
    """Return the Shadow hand of the package ``gymnasium-robotics`` (extra ``hands``; Apache licence).

    Raises:
        ImportError: without that package.
    """
    spec = importlib.util.find_spec("gymnasium_robotics")
    if spec is None or spec.origin is None:
        raise ImportError("the Shadow hand needs gymnasium-robotics: pip install 'jaxgrasp[hands]'")
    path = Path(spec.origin).parent / "envs" / "assets" / "hand" / "reach.xml"
    return HandModel(path, "robot0:palm", gain=4.5)


@checked
def allegro_hand(path: Path) -> HandModel:
    """Return the Allegro hand of an MJCF file of your own, such as MuJoCo Menagerie's ``wonik_allegro``.

    Its fingertips are bodies of their own, which count as the distal links; it has no little finger, and its torques
    are limited to 0.7 N.m, as the maker gives them.
    """
    names: dict[str, tuple[str, str]] = {}
    for prefix, finger in (("ff", "index"), ("mf", "middle"), ("rf", "ring"), ("th", "thumb")):
        last = "proximal" if finger == "thumb" else "middle"
        names |= {f"{prefix}_tip": (finger, "distal"), f"{prefix}_distal": (finger, last)}
    return HandModel(path, "palm", names, force_limit=0.7)


@checked
def robot_spec(
    model: HandModel, home: PalmPose, add_objects: Callable[[Any], None] | None = None, prefix: str = PREFIX
) -> Any:
    """Build the specification of a world with the hand on its arm; ``add_objects`` adds the rest of the world.

    Args:
        model: the hand's file.
        home: pose of the palm where the arm's six joints are zero.
        add_objects: function that adds bodies to the specification.
        prefix: before the names of arm and hand, where a world has several.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for a file without the wrist's body, or one that MuJoCo cannot read.
    """
    mujoco = import_mujoco("robot_spec")
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    if add_objects is not None:
        add_objects(spec)
    add_robot(spec, model, home, prefix)
    return spec


def add_robot(spec: Any, model: HandModel, home: PalmPose, prefix: str = PREFIX) -> None:
    """Add a hand on its arm to a specification; arguments and errors are those of ``robot_spec``."""
    mujoco = import_mujoco("add_robot")
    hand = mujoco.MjSpec.from_file(str(model.path))
    palm = hand.body(model.wrist)
    if palm is None:
        raise ValueError(f"wrist is {model.wrist!r}: {model.path} has no body of that name")
    palm_joints = {joint.name for joint in palm.joints}
    # What refers to a joint goes before it.
    for actuator in [a for a in hand.actuators if a.target in palm_joints]:
        hand.delete(actuator)
    for tendon in [t for t in hand.tendons if any(_target(wrap) in palm_joints for wrap in t.path)]:
        hand.delete(tendon)
    for joint in list(palm.joints):
        hand.delete(joint)
    palm = hand.body(model.wrist)
    palm.pos, palm.quat = np.zeros(3), np.array([1.0, 0, 0, 0])
    for actuator in hand.actuators:
        actuator.gainprm[0] *= model.gain
        actuator.biasprm[1] *= model.gain
        if actuator.forcelimited != mujoco.mjtLimited.mjLIMITED_TRUE and not np.any(actuator.forcerange):
            actuator.forcelimited, actuator.forcerange = 1, [-model.force_limit, model.force_limit]
    for joint in hand.joints:
        joint.damping = np.maximum(joint.damping, FINGER_DAMPING)
    for body in hand.bodies:
        body.gravcomp = 1.0
    arm = spec.worldbody.add_body(name=f"{prefix}arm", pos=home.origin, quat=_quaternion(home.rotation))
    arm.gravcomp = 1.0
    kinds = (mujoco.mjtJoint.mjJNT_SLIDE,) * 3 + (mujoco.mjtJoint.mjJNT_HINGE,) * 3
    for k, name in enumerate(ARM_JOINTS):
        # Slides are along the world's axes, which are turned into the frame of home.
        axis = home.rotation.T[:, k] if k < 3 else np.eye(3)[k - 3]
        arm.add_joint(
            name=prefix + name, type=kinds[k], axis=axis, armature=ARM_ARMATURE[k], damping=ARM_DAMPING[k], limited=0
        )
    # Options of the hand's file that are not used here, of which MuJoCo would warn.
    hand.option.iterations = spec.option.iterations
    for size in ("njmax", "nconmax", "nuser_jnt", "nuser_site", "nuser_tendon", "nuser_actuator", "nuser_sensor"):
        setattr(hand, size, getattr(spec, size))
    arm.add_frame().attach_body(palm, prefix, "")
    for k, name in enumerate(ARM_JOINTS):
        stiffness, limit = ARM_STIFFNESS[k], ARM_LIMITS[k]
        spec.add_actuator(
            name=prefix + name,
            target=prefix + name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gainprm=[stiffness, *[0.0] * 9],
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=[0.0, -stiffness, *[0.0] * 8],
            forcelimited=1,
            forcerange=[-limit, limit],
        )


def _target(wrap: Any) -> str:
    return getattr(getattr(wrap, "target", None), "name", "")


class MujocoFollower(Follower):
    """A hand on an arm in a MuJoCo world; ``read`` advances the world to the time that it is asked for."""

    def __init__(
        self,
        spec: Any,
        model: HandModel,
        home: PalmPose,
        handled: str,
        *,
        prefix: str = PREFIX,
        shared: "MujocoFollower | None" = None,
    ) -> None:
        """Create the robot, at home with all joints as in the file.

        Args:
            spec: from ``robot_spec``.
            model: the hand's file.
            home: as for ``robot_spec``.
            handled: name of the body whose contacts with the hand are measured.
            prefix: as for ``robot_spec``.
            shared: another follower of the same world, whose simulation this one shares and never advances.

        Raises:
            ValueError: for a body that the world lacks.
        """
        self._mujoco = import_mujoco("MujocoFollower")
        self.model: Any = spec.compile() if shared is None else shared.model
        self.data: Any = self._mujoco.MjData(self.model) if shared is None else shared.data
        self._advances = shared is None
        imported = hand_from_mujoco(self.model, prefix + model.wrist)
        names = {prefix + name: finger for name, finger in model.names.items()}
        self.hand = name_fingers(imported.hand, names)
        """Hand of the package with the robot's joints and links."""
        self.joints = self.hand.joints
        self.links = tuple(link.name for link in self.hand.links)
        self._home, self._home_rotation = home, Rotation.from_matrix(home.rotation)
        self._palm = self._body(prefix + model.wrist)
        self._handled = self._body(handled)
        self._angle_index = imported.addresses
        arm = [self.model.joint(prefix + name) for name in ARM_JOINTS]
        self._arm_angles = np.array([joint.qposadr[0] for joint in arm])
        self._arm_motors = np.array([self.model.actuator(prefix + name).id for name in ARM_JOINTS])
        motors = {int(self.model.actuator_trnid[k, 0]): k for k in range(self.model.nu)}
        joint_ids = [self.model.joint(name).id for name in self.joints]
        pairs = [(i, motors[joint]) for i, joint in enumerate(joint_ids) if joint in motors]
        self._motor_joints, self._motors = (np.array(column, int) for column in zip(*pairs, strict=True))
        self._link_of_geom = self._number_geoms(imported.bodies)
        self._object_geoms = self.model.body_rootid[self.model.geom_bodyid] == self.model.body_rootid[self._handled]
        self._cause, self._commanded_at = "", 0.0
        self._held = np.concatenate([self.data.qpos[self._angle_index[self._motor_joints]], np.zeros(6)])
        self._set_controls()
        self._mujoco.mj_forward(self.model, self.data)

    @property
    def wrist_force(self) -> Float[np.ndarray, "6"]:
        """Return forces and torques of the arm's motors, along their joints [N, N.m]."""
        return self.data.actuator_force[self._arm_motors].copy()

    def command(self, timestamp: float, angles: Float[np.ndarray, "J"], palm: PalmPose) -> None:
        check_command(self.joints, angles, palm)
        turn = self._home_rotation.inv() * Rotation.from_matrix(palm.rotation)
        arm = np.concatenate([palm.origin - self._home.origin, turn.as_euler("XYZ")])
        self._held = np.concatenate([np.asarray(angles, float)[self._motor_joints], arm])
        self._commanded_at = timestamp

    def read(self, timestamp: float) -> FollowerState:
        if timestamp - self._commanded_at > MAX_SILENCE and not self._cause:
            self._hold()
        while self._advances and self.data.time < timestamp - TIMESTEP / 2:
            self._set_controls()
            self._mujoco.mj_step(self.model, self.data)
        return FollowerState(
            float(self.data.time),
            self.data.qpos[self._angle_index].copy(),
            PalmPose(self.data.xpos[self._palm].copy(), self.data.xmat[self._palm].reshape(3, 3).copy()),
            self.contacts(),
            self.data.xipos[self._handled].copy(),
            self._cause,
        )

    def stop(self, cause: str) -> None:
        self._cause = self._cause or cause

    def release(self) -> None:
        self._cause = ""
        self._hold()

    def restart(self, angles: Float[np.ndarray, "J"]) -> None:
        """Put the whole world back to its start, with the hand's joints at angles [rad]."""
        self._mujoco.mj_resetData(self.model, self.data)
        self._held[:], self._cause, self._commanded_at = 0.0, "", 0.0
        self.data.qpos[self._angle_index] = angles
        self._held[: len(self._motors)] = np.asarray(angles)[self._motor_joints]
        self._set_controls()
        self._mujoco.mj_forward(self.model, self.data)

    def environment_force(self) -> Float[np.ndarray, "3"]:
        """Compute the force of everything but the hand's links on the handled object by contact [N]."""
        total, force = np.zeros(3), np.zeros(6)
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            for other_geom, object_geom, sign in ((*contact.geom, 1.0), (*contact.geom[::-1], -1.0)):
                if (
                    self._object_geoms[object_geom]
                    and self._link_of_geom[other_geom] < 0
                    and not self._object_geoms[other_geom]
                ):
                    self._mujoco.mj_contactForce(self.model, self.data, k, force)
                    total += sign * force[:3] @ contact.frame.reshape(3, 3)
        return total

    def _hold(self) -> None:
        """Make the measured posture the command, once."""
        self._held = self._measured()
        self._commanded_at = np.inf

    def _measured(self) -> Float[np.ndarray, "motors"]:
        return self.data.qpos[np.concatenate([self._angle_index[self._motor_joints], self._arm_angles])]

    def _set_controls(self) -> None:
        # After an emergency stop the command is the posture itself, so that control exerts no force.
        values = self._measured() if self._cause else self._held
        self.data.ctrl[self._motors], self.data.ctrl[self._arm_motors] = values[:-6], values[-6:]

    def contacts(self) -> FollowerContacts:
        """Return the present contacts of the hand with the handled object."""
        data, rows, force = self.data, [], np.zeros(6)
        for k in range(data.ncon):
            contact = data.contact[k]
            first, second = contact.geom
            for hand_geom, object_geom, sign in ((first, second, 1.0), (second, first, -1.0)):
                if self._link_of_geom[hand_geom] >= 0 and self._object_geoms[object_geom]:
                    # MuJoCo's normal points from the first geom to the second, along which the force on it acts.
                    self._mujoco.mj_contactForce(self.model, data, k, force)
                    axes = contact.frame.reshape(3, 3)
                    rows.append((contact.pos, sign * axes[0], sign * force[:3] @ axes, self._link_of_geom[hand_geom]))
        if not rows:
            return FollowerContacts.none()
        points, normals, forces, links = (np.array(column) for column in zip(*rows, strict=True))
        return FollowerContacts(points, normals, forces, links)

    def _number_geoms(self, bodies: np.ndarray) -> np.ndarray:
        """Return the index of each geom's link; -1 for geoms of no link."""
        link_of_body = np.full(self.model.nbody, -1)
        link_of_body[bodies] = np.arange(len(bodies))
        return link_of_body[self.model.geom_bodyid]

    def _body(self, name: str) -> int:
        index = self._mujoco.mj_name2id(self.model, self._mujoco.mjtObj.mjOBJ_BODY, name)
        if index < 0:
            raise ValueError(f"the world has no body {name!r}")
        return index


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    return Rotation.from_matrix(rotation).as_quat(scalar_first=True)
