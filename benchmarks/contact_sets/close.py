"""Simulation of one grip from its seed: place the object, close the hand, let go, turn on gravity, wait for rest.

A soft contact must have a meaningful depth, so every link has a stiffness of its own, in N/m: about 1 N/mm
at first touch on a fingertip, more on the other phalanges and the palm, and rising nearly fourfold over 3 mm,
as a finger's pulp does. MuJoCo's own default would make depth depend on the inertia of the finger behind it.
So one stiffness for all contacts (eq. 6) is right on average and wrong for each, as it is for a user.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.contact_sets import objects
from benchmarks.contact_sets.hands import FINGERS, HANDS, SERVO_GAIN, Hand
from benchmarks.contact_sets.objects import GraspedObject
from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco

GRIPS = ("precision", "power")
RECIPES = ("precision", "power", "firm")
"""How a grip is made: fingertips on a small object, the whole hand around one, or a firm hold of a slab, where
the torques fall along each finger so that all its phalanges press and not its end alone.
"""
STRENGTHS = {"precision": (0.2, 1.5), "power": (0.35, 3.0), "firm": (1.5, 3.5)}
"""Factors on the torque limits; drawn evenly in the logarithm."""
LINK_STIFFNESS = {"distal": 1000.0, "middle": 1500.0, "proximal": 1500.0, "palm": 2500.0}
"""[N/m] at first touch."""
IMPEDANCE = (0.85, 0.95, 0.003, 0.5, 2.0)
"""MuJoCo's ``solimp``: stiffness goes as d^2 / (1 - d), from 4.8 to 18 over 3 mm."""
MOST_CONTACTS = 20
DEEPEST = 0.005
"""[m]: most of a finger's radius, where a depth no longer means anything."""
TIMESTEP = 0.002
CLOSING, HOLDING, SEATING, LOADING, SETTLING = 0.6, 0.2, 0.3, 0.3, 2.0
"""Durations of the phases [s]: servos ramp; the grip comes to rest; a firm one moves the object to where the hand
likes it; gravity ramps; the longest wait."""
REST_SPEED, REST_ACCELERATION = 2e-3, 0.03
"""[m/s], [m/s^2] at the object's surface: less than 0.3% of a weight is unbalanced."""
REACH = 0.03
"""From an object's centre to its surface, for judging its turning [m]."""
BEYOND_MIDDLE = 0.008
"""From the middle of a distal phalanx to the place that a pinch aims at [m]."""
CHUNK = 25
"""Steps between two looks at the state."""


@dataclass(frozen=True)
class Grip:
    """Outcome of one sample."""

    sample: int
    hand: str
    shape: str
    recipe: str
    """One of ``RECIPES``; what touched in the end is ``grip``."""
    outcome: str
    """``kept``, ``fallen``, ``unsettled``, ``too deep``, ``too few contacts`` or ``too many contacts``."""
    held_object: GraspedObject
    contacts: MujocoGrasp | None
    """Of a kept grip only."""

    @property
    def grip(self) -> str:
        """Name the grip by its contacts: ``precision`` if only distal phalanges touch, else ``power``."""
        links = self.contacts.links if self.contacts else ()
        return GRIPS[not all(link.endswith("distal") for link in links)]


@dataclass(frozen=True)
class Scene:
    """A hand, an object, and the simulator that holds both."""

    hand: Hand
    held_object: GraspedObject
    recipe: str
    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def pinching(self) -> bool:
        return self.recipe == "precision"


def simulate(seed: int, sample: int) -> Grip:
    """Simulate grip number ``sample`` of ``seed``; the result depends on these two only."""
    rng = np.random.default_rng((seed, sample))
    hand = tuple(HANDS.values())[sample % 2]
    recipe = RECIPES[sample // 8 % 3]
    shape = objects.SHAPES[recipe][sample // 2 % 4]
    held_object = objects.draw(rng, shape, recipe)
    model = _build(hand, held_object)
    scene = Scene(hand, held_object, recipe, model, mujoco.MjData(model))
    used = _place_at_fingertips(rng, scene) if scene.pinching else _place_in_palm(rng, scene)
    _close(rng, scene, used)
    outcome = _let_go(rng, scene)
    contacts = None
    if outcome == "at rest":
        contacts = from_mujoco(model, scene.data, "object", squeeze="normal_force")
        outcome = _judge(contacts)
    return Grip(sample, hand.name, shape, recipe, outcome, held_object, contacts if outcome == "kept" else None)


def _judge(contacts: MujocoGrasp) -> str:
    if len(contacts.links) < 2:
        return "too few contacts"
    if len(contacts.links) > MOST_CONTACTS:
        return "too many contacts"
    return "kept" if contacts.depths.max() <= DEEPEST else "too deep"


def _build(hand: Hand, held_object: GraspedObject) -> mujoco.MjModel:
    spec = hand.spec()
    held_object.add_to(spec)
    model = spec.compile()
    model.opt.timestep = TIMESTEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model.opt.impratio = 100  # Friction is regularised too, and at 1 a held object creeps by 10 mm/s.
    model.opt.iterations, model.opt.tolerance = 100, 1e-10
    model.opt.gravity[:] = 0
    model.geom_friction[:, 0] = held_object.friction
    _soften(model)
    return model


def _soften(model: mujoco.MjModel) -> None:
    """Give every link of the hand its stiffness in N/m, whatever its inertia is."""
    first, last = IMPEDANCE[:2]
    of_object = model.body_invweight0[model.body("object").id, 0]
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        link = model.body(body).name
        kind = "palm" if link.startswith("palm") else link.rpartition("_")[2]
        if kind not in LINK_STIFFNESS:
            continue
        inverse_mass = model.body_invweight0[body, 0] + of_object
        # At rest MuJoCo's force is k d^2 / (1 - d) * depth / inverse mass, where k = -solref[0] / last^2.
        stiffness = LINK_STIFFNESS[kind] * inverse_mass * (1 - first) / first**2
        model.geom_solref[geom] = -stiffness * last**2, -2 * np.sqrt(stiffness * last) * last
        model.geom_solimp[geom] = IMPEDANCE


def _place_in_palm(rng: np.random.Generator, scene: Scene) -> tuple[str, ...]:
    """Lay the object before the palm, its long axis along the knuckles; return the digits, all of which close."""
    hand, held_object = scene.hand, scene.held_object
    gap = 0.002
    firm = scene.recipe == "firm"
    # A slab that lay lower would be in the way of the thumb's base; one that lay askew would touch with edges.
    forward, askew = (0.016, 0.5) if firm else (0.005, 1.0)
    center = hand.palm + hand.palmar * (held_object.half_width + gap) + hand.distal * rng.normal(forward, 0.008 * askew)
    center = center + hand.across * rng.normal(0, 0.006 * askew)
    axes = np.stack([hand.palmar, -hand.distal, -hand.across], -1)
    axes = _turn(hand.palmar, rng.normal(0, 0.25 * askew)) @ axes
    if firm:
        axes = _turn(hand.distal, hand.arch) @ axes
    _set_object_pose(scene, center, axes @ _turn(np.array([0.0, 0.0, 1.0]), rng.uniform(-0.3, 0.3) * askew))
    _pose(scene, 0.0)
    return ("thumb", *FINGERS)


def _place_at_fingertips(rng: np.random.Generator, scene: Scene) -> tuple[str, ...]:
    """Put the object between the thumb's tip and some fingers'; return the digits, only which close."""
    hand = scene.hand
    count = int(rng.choice([1, 2, 3, 4], p=[0.4, 0.2, 0.2, 0.2]))
    start = int(rng.integers(0, 2)) if count < 4 else 0
    used = ("thumb", *FINGERS[start : start + count])
    _set_object_pose(scene, hand.palm - hand.palmar, np.eye(3))
    thumb, thumb_radius, pinch, radius = _preshape(scene, used)
    width = np.linalg.norm(pinch)
    pinch = pinch / width
    center = thumb + pinch * (thumb_radius + (width - thumb_radius - radius) / 2)
    along = hand.across - pinch * (hand.across @ pinch)
    along /= np.linalg.norm(along)
    axes = np.stack([pinch, np.cross(along, pinch), along], -1)
    _set_object_pose(scene, center + rng.normal(0, 0.002, 3), _turn(pinch, rng.uniform(-0.5, 0.5)) @ axes)
    return used


def _preshape(scene: Scene, used: tuple[str, ...]) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Close ``used`` fingers until the object just fits; the thumb's tip and radius, the way across and its radius."""
    for fraction in np.linspace(0.0, 1.0, 51):
        _pose(scene, fraction, used)
        mujoco.mj_kinematics(scene.model, scene.data)
        thumb, thumb_radius = _tip(scene, "thumb")
        tips = [_tip(scene, finger) for finger in used[1:]]
        pinch, radius = np.mean([tip for tip, _ in tips], 0) - thumb, tips[0][1]
        if np.linalg.norm(pinch) < 2 * scene.held_object.half_width + thumb_radius + radius + 0.002:
            break
    return thumb, thumb_radius, pinch, radius


def _tip(scene: Scene, finger: str) -> tuple[np.ndarray, float]:
    """Return the position of a fingertip's pad, well beyond the last joint, and its radius [m]."""
    model, data = scene.model, scene.data
    body = model.body(f"{finger}_distal").id
    geom = model.body_geomadr[body]
    outward = data.geom_xpos[geom] - data.xpos[body]
    pad = data.geom_xpos[geom] + outward * (BEYOND_MIDDLE / np.linalg.norm(outward))
    return pad, float(model.geom_size[geom, 0])


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _set_object_pose(scene: Scene, center: np.ndarray, axes: np.ndarray) -> None:
    """Move the object and the weld that holds it."""
    model, data = scene.model, scene.data
    start = model.joint("object").qposadr[0]
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.reshape(9))
    data.qpos[start : start + 7] = [*center, *quaternion]
    # A weld's data: anchor in the second body, then pose of the second body in the first.
    model.eq_data[model.equality("hold").id, :10] = [0, 0, 0, *(-axes.T @ center), *(quaternion * [1, -1, -1, -1])]


def _pose(scene: Scene, fraction: float, used: tuple[str, ...] = ()) -> None:
    """Set joints and servos: ``used`` fingers pinch by ``fraction``, the others are open."""
    model, data = scene.model, scene.data
    for joint in scene.hand.joints:
        angle = joint.angle(fraction if joint.finger in used else 0.0, pinching=True)
        data.qpos[model.joint(joint.name).qposadr[0]] = angle
        data.ctrl[model.actuator(joint.name).id] = angle


def _close(rng: np.random.Generator, scene: Scene, used: tuple[str, ...]) -> None:
    """Ramp the servos of ``used`` fingers to a fist, or to a pinch, with limits drawn for this grip."""
    model, data = scene.model, scene.data
    strength = np.exp(rng.uniform(*np.log(STRENGTHS[scene.recipe])))
    share = {finger: rng.uniform(0.6, 1.4) for finger in ("thumb", *FINGERS)}
    # One thumb opposes them all; in a firm grip the palm does, too.
    share["thumb"] *= 1.0 + (0.08 if scene.recipe == "firm" else 0.35) * (len(used) - 2)
    begin = data.ctrl.copy()
    end = begin.copy()
    for joint in scene.hand.joints:
        if joint.finger not in used:
            continue
        servo = model.actuator(joint.name).id
        factor = strength * share[joint.finger]
        torque = joint.wrapping if scene.recipe == "firm" else joint.torque
        limit = torque * (factor if joint.closes else max(factor, 1.0))
        model.actuator_forcerange[servo] = -limit, limit
        end[servo] = joint.angle(1.0, scene.pinching)
    for part in np.linspace(0, 1, round(CLOSING / TIMESTEP / CHUNK) + 1)[1:]:
        data.ctrl[:] = begin + part * (end - begin)
        mujoco.mj_step(model, data, CHUNK)
    mujoco.mj_step(model, data, round(HOLDING / TIMESTEP))
    if scene.recipe == "firm":
        data.eq_active[model.equality("hold").id] = 0
        mujoco.mj_step(model, data, round(SEATING / TIMESTEP))


def _let_go(rng: np.random.Generator, scene: Scene) -> str:
    """Let go, load and wait: ``at rest``, ``fallen`` or ``unsettled``."""
    model, data = scene.model, scene.data
    # From here on every servo is a spring about the grip: a limited torque alone would let it drift away.
    data.ctrl[:] = data.actuator_length + data.actuator_force / SERVO_GAIN
    data.eq_active[model.equality("hold").id] = 0
    start = data.body("object").xpos.copy()
    down = rng.normal(size=3)
    down *= 9.81 / np.linalg.norm(down)
    for part in np.linspace(0, 1, round(LOADING / TIMESTEP / CHUNK) + 1)[1:]:
        model.opt.gravity[:] = part * down
        mujoco.mj_step(model, data, CHUNK)
    calm = 0
    for _ in range(round(SETTLING / TIMESTEP / CHUNK)):
        mujoco.mj_step(model, data, CHUNK)
        if np.linalg.norm(data.body("object").xpos - start) > 0.08:
            return "fallen"
        calm = calm + 1 if _is_calm(scene) else 0
        if calm == 4:
            mujoco.mj_forward(model, data)  # Contacts and forces of this state, not of the step before.
            return "at rest" if _is_calm(scene) else "unsettled"
    return "unsettled"


def _is_calm(scene: Scene) -> bool:
    first = scene.model.joint("object").dofadr[0]
    motion, scale = slice(first, first + 6), np.repeat([1.0, REACH], 3)
    slow = np.linalg.norm(scene.data.qvel[motion] * scale) < REST_SPEED
    return bool(slow and np.linalg.norm(scene.data.qacc[motion] * scale) < REST_ACCELERATION)
