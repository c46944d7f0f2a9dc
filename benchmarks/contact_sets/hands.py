"""Two real hand models, MyoHand and the Shadow hand, stripped to bones that collide and servos that pull.

Both stand still in the world: arm and wrist lose their joints, gravity is turned instead. Muscles, tendons,
meshes and sensors are dropped, which also makes a model compile in a millisecond. Bodies are renamed
``index_distal``, ``thumb_proximal``, ``palm...``, so that both hands speak of the same links.
"""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

FINGERS = ("index", "middle", "ring", "little")
SERVO_GAIN = 3.0
"""[N.m/rad] of every position servo; its torque limit, drawn for each grip, comes first."""


@dataclass(frozen=True)
class Joint:
    """Range and direction of one joint's motion in a grip."""

    name: str
    finger: str
    open: float
    """Angle at rest [rad]."""
    closed: float
    """Where the servo is sent when the hand closes [rad]; equal to ``open`` for a joint that holds its place."""
    torque: float
    """Limit of the servo at strength 1 [N.m]."""
    pinched: float = 1.0
    """How far towards ``closed`` the joint goes when fingertips pinch: pads meet if end joints stay straight."""
    firm: float = 1.0
    """Factor on ``torque`` in a firm grip; end joints pull less there, or they would lift the phalanges before them."""

    def angle(self, fraction: float, pinching: bool) -> float:
        """Return the joint's angle when the hand is closed by ``fraction`` [rad]."""
        return self.open + fraction * (self.closed - self.open) * (self.pinched if pinching else 1.0)

    @property
    def wrapping(self) -> float:
        """Limit of the servo at strength 1 in a firm grip [N.m]."""
        return self.torque * self.firm

    @property
    def closes(self) -> bool:
        return self.open != self.closed


@dataclass(frozen=True)
class Hand:
    """A hand in its own world frame."""

    name: str
    build: Callable[[], mujoco.MjSpec]
    joints: tuple[Joint, ...]
    palm: np.ndarray
    """A point on the skin of the palm, below the knuckles [m]."""
    distal: np.ndarray
    """Unit vector from the wrist to the fingers."""
    palmar: np.ndarray
    """Unit vector out of the palm."""
    arch: float = 0.0
    """How far a slab must turn about ``distal`` to lie flat on the palm, whose edges may stand up [rad]."""

    @property
    def across(self) -> np.ndarray:
        """Return the unit vector along the knuckles."""
        return np.cross(self.palmar, self.distal)

    def spec(self) -> mujoco.MjSpec:
        """Return a fresh copy of the stripped model, with one position servo a joint."""
        return _spec(self.name).copy()


@functools.cache
def _spec(name: str) -> mujoco.MjSpec:
    hand = HANDS[name]
    spec = hand.build()
    for joint in hand.joints:
        spec.joint(joint.name).armature = 5e-4  # MyoHand's 1e-4 leaves a fingertip almost no inertia.
        spec.add_actuator(
            name=joint.name,
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gainprm=[SERVO_GAIN, *[0] * 9],
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=[0, -SERVO_GAIN, -0.1, *[0] * 7],
            forcelimited=True,
            forcerange=[-joint.torque, joint.torque],
        )
    return spec


def _strip(spec: mujoco.MjSpec, joints: set[str], names: dict[str, str]) -> mujoco.MjSpec:
    """Keep what collides and the joints that move; rename the bodies and mark who collides with whom."""
    shapes = {mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID}
    for geom in list(spec.geoms):
        skin = geom.parent.name in names and geom.type in shapes and (geom.contype or geom.conaffinity)
        if not skin:
            spec.delete(geom)
            continue
        geom.material = ""
        geom.priority = 1  # The hand's softness and friction decide, whatever the object's are.
        geom.condim = 3
        geom.margin = 0
        geom.contype, geom.conaffinity = _collides(names[geom.parent.name])
    removed = (spec.actuators, spec.tendons, spec.sensors, spec.excludes, spec.pairs, spec.skins, spec.meshes)
    for group in (*removed, spec.materials, spec.textures, spec.sites, spec.lights, spec.cameras, spec.equalities):
        for element in list(group):
            spec.delete(element)
    for joint in list(spec.joints):
        if joint.name not in joints:
            spec.delete(joint)
    for body in spec.bodies:
        body.gravcomp = 1  # The servos' torque is for the grip, not for the fingers' own weight.
        body.name = names.get(body.name, body.name)
    return spec


def _collides(link: str) -> tuple[int, int]:
    """Return the collision bits of a link: 1 for hand on object, 2 for thumb on fingers.

    Neighbouring links overlap at rest and must not collide.
    """
    if link in ("thumb_middle", "thumb_distal"):
        return 3, 0
    return (1, 2) if link.startswith(FINGERS) else (1, 0)


def _build_myohand() -> mujoco.MjSpec:
    from myo_sim.build.compose import build_right_hand_from_arm_spec

    names = {"firstmc_r": "thumb_proximal", "proximal_thumb_r": "thumb_middle", "distal_thumb_r": "thumb_distal"}
    for i, (finger, ordinal) in enumerate(zip(FINGERS, ("second", "third", "fourth", "fifth"), strict=True), 2):
        names |= {f"{ordinal}mc_r": f"palm_{finger}", f"{i}proxph_r": f"{finger}_proximal"}
        names |= {f"midph{i}_r": f"{finger}_middle", f"distph{i}_r": f"{finger}_distal"}
    spec = build_right_hand_from_arm_spec()
    _lock(spec, "cmc_flexion_r", -0.25)  # In opposition; without it the hand has a glove's 14 + 5 joints.
    return _strip(spec, {j.name for j in MYOHAND.joints}, names)


def _lock(spec: mujoco.MjSpec, name: str, angle: float) -> None:
    """Turn the body of a joint to ``angle`` for good; the joint must be the body's first, at its origin."""
    joint = spec.joint(name)
    turn, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, joint.axis / np.linalg.norm(joint.axis), angle)
    mujoco.mju_mulQuat(turned, joint.parent.quat, turn)
    joint.parent.quat = turned
    spec.delete(joint)


def _build_shadow() -> mujoco.MjSpec:
    package = importlib.util.find_spec("gymnasium_robotics")
    if package is None or package.origin is None:
        raise ImportError("the Shadow hand needs gymnasium-robotics: pip install 'jaxgrasp[hands]'")
    # Importing the package would register environments and load gymnasium for nothing.
    path = Path(package.origin).parent / "envs" / "assets" / "hand" / "reach.xml"
    names = {"robot0:palm": "palm", "robot0:lfmetacarpal": "palm_little"}
    for short, finger in zip(("ff", "mf", "rf", "lf", "th"), (*FINGERS, "thumb"), strict=True):
        names |= {f"robot0:{short}{link}": f"{finger}_{link}" for link in ("proximal", "middle", "distal")}
    return _strip(mujoco.MjSpec.from_file(str(path)), {j.name for j in SHADOW.joints}, names)


def _myohand_joints() -> tuple[Joint, ...]:
    thumb = (
        Joint("cmc_abduction_r", "thumb", 0.55, 0.55, 0.6),
        Joint("mp_flexion_r", "thumb", 0.4, -0.75, 0.25, 0.7),
        Joint("ip_flexion_r", "thumb", 0.1, -1.2, 0.12, 0.1, 0.4),
    )
    fingers = []
    for i, finger in enumerate(FINGERS, 2):
        fingers += [
            Joint(f"mcp{i}_abduction_r", finger, 0.0, 0.0, 0.3),
            Joint(f"mcp{i}_flexion_r", finger, 0.1, 1.5, 0.25, 0.75, 1.6),
            Joint(f"pm{i}_flexion_r", finger, 0.1, 1.5, 0.15, 0.5, 0.6),
            Joint(f"md{i}_flexion_r", finger, 0.1, 1.2, 0.08, 0.3, 0.25),
        ]
    return (*thumb, *fingers)


def _shadow_joints() -> tuple[Joint, ...]:
    thumb = (
        Joint("robot0:THJ4", "thumb", 0.7, 0.7, 0.6),
        Joint("robot0:THJ3", "thumb", 1.2, 1.2, 0.6),
        Joint("robot0:THJ2", "thumb", 0.0, 0.0, 0.6),
        Joint("robot0:THJ1", "thumb", 0.5, -0.5, 0.25, 0.3),
        Joint("robot0:THJ0", "thumb", -0.1, -1.4, 0.12, 0.05, 0.4),
    )
    fingers = [Joint("robot0:LFJ4", "little", 0.1, 0.1, 0.5)]
    for short, finger in zip(("FF", "MF", "RF", "LF"), FINGERS, strict=True):
        fingers += [
            Joint(f"robot0:{short}J3", finger, 0.0, 0.0, 0.3),
            Joint(f"robot0:{short}J2", finger, 0.1, 1.5, 0.25, 0.75, 1.6),
            Joint(f"robot0:{short}J1", finger, 0.1, 1.5, 0.15, 0.5, 0.6),
            Joint(f"robot0:{short}J0", finger, 0.1, 1.2, 0.08, 0.3, 0.25),
        ]
    return (*thumb, *fingers)


MYOHAND = Hand(
    name="myohand",
    build=_build_myohand,
    joints=_myohand_joints(),
    palm=np.array([0.598, 0.010, 0.168]),
    distal=np.array([1.0, 0.0, 0.0]),
    palmar=np.array([0.0, 0.0, -1.0]),
    arch=0.35,
)
SHADOW = Hand(
    name="shadow",
    build=_build_shadow,
    joints=_shadow_joints(),
    palm=np.array([0.995, 0.885, 0.151]),
    distal=np.array([0.0, -1.0, 0.0]),
    palmar=np.array([0.0, 0.0, 1.0]),
)
HANDS = {hand.name: hand for hand in (MYOHAND, SHADOW)}
