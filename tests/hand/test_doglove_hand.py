"""DOGlove's linkage as a hand: caps where the published transforms have them, and torques by work."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.other_devices.doglove import BOARD_BAUD, SERVO_BAUD, DogloveHost, doglove_linkage, doglove_sensors
from jaxgrasp.glove.simulated.simulation import MemoryLine
from jaxgrasp.hand import (
    Pose,
    Posture,
    closing_kinematics,
    doglove_hand,
    human_hand,
    joint_torques,
    linkage_angles,
    pose_hand,
)
from tests.glove import simulated_doglove as published

FINGERS = ("thumb", "index", "middle", "ring", "little")
HAND = doglove_hand()
FINGER_TURN = (-1.5707963267949, -0.785398163397448, 1.5707963267949)
ACROSS = (1.0, 0.0, 0.0)
# From the published URDF: each chain's joints by origin, roll-pitch-yaw and axis, then the tip of the MuJoCo model.
CHAINS = {
    "thumb": [
        ((-0.0475, -0.092589, -0.07964), (-1.5708, 0.0, 1.5708), (0.0, 1.0, 0.0)),
        ((-0.031, 0.0, 0.0075), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
        ((0.0, 0.04, -0.0045), (0.0, 0.0, 0.0), ACROSS),
        ((-0.002, 0.05, 0.0), (0.0, 0.0, 0.0), ACROSS),
        ((0.002, 0.04, 0.0), (0.0, 0.0, 0.0), ACROSS),
        (0.0, 0.05, 0.0),
    ]
}
for name, y, z, first, second in (
    ("index", -0.0601040764008531, -0.104852813742388, 0.07, 0.06),
    ("middle", -0.0417193000900034, -0.0864680374315374, 0.078, 0.065),
    ("ring", -0.0233345237791538, -0.0680832611206866, 0.073, 0.06),
    ("little", -0.0049497, -0.049698, 0.065, 0.055),
):
    CHAINS[name] = [
        ((-0.085, y, z), FINGER_TURN, (0.0, 0.0, 1.0)),
        ((0.0, 0.045, -0.0365), (0.0, 0.0, 0.0), ACROSS),
        ((0.0, first, 0.0), (0.0, 0.0, 0.0), ACROSS),
        ((0.0, second, 0.0), (0.0, 0.0, 0.0), ACROSS),
        (0.0, 0.045, 0.0),
    ]
# Published mapping of the readings to the URDF's angles: encoder or servo, degrees at zero, and sign, by chain from the
# base outwards.
READINGS = {
    "thumb": [(3, 270.0, 1), (2, 180.0, 1), (16, 182.2, -1), (1, 270.0, 1), (0, 90.0, -1)],
    "index": [(6, 180.0, -1), (17, 165.2, -1), (5, 270.0, 1), (4, 90.0, -1)],
    "middle": [(9, 180.0, -1), (18, 150.29, -1), (8, 270.0, 1), (7, 90.0, -1)],
    "ring": [(12, 180.0, -1), (19, 151.44, -1), (11, 270.0, 1), (10, 90.0, -1)],
    "little": [(15, 180.0, -1), (20, 145.9, -1), (14, 270.0, 1), (13, 90.0, -1)],
}
# Ours of the URDF's base: forward along the fingers, towards the thumb, and out of the back of the hand.
FRAME = np.array([[0.0, 1.0, -1.0], [0.0, -1.0, -1.0], [-math.sqrt(2), 0.0, 0.0]]) / math.sqrt(2)


def about(axis, angle: float) -> np.ndarray:
    """Homogeneous rotation by the matrix exponential's series in closed form."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * k + (1 - math.cos(angle)) * k @ k
    return matrix


def at(origin) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = origin
    return matrix


def published_tips(angles: dict[str, list[float]]) -> np.ndarray:
    """Tips ``(5, 3)`` in the URDF's base, for the URDF's angles of each chain."""
    tips = []
    for finger in FINGERS:
        *joints, tip = CHAINS[finger]
        matrix = np.eye(4)
        for (origin, (roll, pitch, yaw), axis), angle in zip(joints, angles[finger], strict=True):
            turn = about((0, 0, 1), yaw) @ about((0, 1, 0), pitch) @ about((1, 0, 0), roll)
            matrix = matrix @ at(origin) @ turn @ about(axis, angle)
        tips.append((matrix @ [*tip, 1.0])[:3])
    return np.array(tips)


def caps(hand, angles) -> np.ndarray:
    links = pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(angles))).links
    return np.asarray(links.origin + jnp.einsum("lij,lj->li", links.rotation, hand.skin.centers[:, -1]))


def urdf_signs(finger: str) -> list[int]:
    """Signs of the URDF's angles in ours: bends and opposition negative; abduction towards the thumb positive."""
    if finger == "thumb":
        return [-1, -1, -1, -1, -1]
    return [1 if finger in ("index", "middle") else -1, -1, -1, -1]


def to_urdf(angles: np.ndarray) -> dict[str, list[float]]:
    parts = np.split(angles, [5, 9, 13, 17])
    return {finger: (part * urdf_signs(finger)).tolist() for finger, part in zip(FINGERS, parts)}


def test_caps_are_where_the_published_transforms_have_them():
    rng = np.random.default_rng(0)
    shifts = []
    for _ in range(10):
        angles = rng.uniform(HAND.lower, HAND.upper)
        shifts.append(caps(HAND, angles) - published_tips(to_urdf(angles)) @ FRAME.T)
    # One shift for all caps and all postures: the place of the wrist. The URDF rounds the little finger's and thumb's.
    shift = np.mean(shifts, (0, 1))
    np.testing.assert_allclose(shifts, np.broadcast_to(shift, (10, 5, 3)), atol=3e-6)
    np.testing.assert_allclose(shift, [0.008, -0.090642, -0.02], atol=2e-6)
    moved = doglove_hand(wrist=(0.01, 0.02, 0.03))
    np.testing.assert_allclose(caps(moved, angles) - caps(HAND, angles), [[-0.018, -0.02, -0.01]] * 5, atol=1e-12)


def test_readings_become_the_published_softwares_fingertips():
    """From encoder voltages and servo positions to caps: signs and zeros, through the driver."""
    model = doglove_linkage()
    assert model.joints == HAND.joints and len(model.joints) == 21
    glove, rng = published.Glove(), np.random.default_rng(1)
    line, board = MemoryLine(SERVO_BAUD), MemoryLine(BOARD_BAUD)
    host = DogloveHost(model, doglove_sensors(model), lambda: line, lambda: board, Guard(model))
    raw = {sensor: zero + float(rng.uniform(-40, 40)) for rows in READINGS.values() for sensor, zero, _ in rows}
    glove.board.degrees = [raw[k] for k in range(16)]
    for k, servo in enumerate(glove.chain.servos):
        servo.degrees = raw[16 + k]
    for step in range(60):
        now = 0.005 * step
        line.to_host += glove.chain.exchange(now, bytes(line.to_device))
        board.to_host += glove.board.exchange(now, b"")
        line.to_device.clear()
        host.poll(now)
        host.send(now, np.zeros(21), now)
    urdf = {f: [math.radians(sign * (raw[k] - zero)) for k, zero, sign in rows] for f, rows in READINGS.items()}
    expected = published_tips(urdf) @ FRAME.T + [0.008, -0.090642, -0.02]
    # 4096 positions of a servo are 1.5 mrad, of chains that are 0.2 m long.
    np.testing.assert_allclose(caps(HAND, host.reading.angles), expected, atol=4e-4)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_servos_torque_does_the_work_of_the_force_at_the_cap(side):
    hand, model, rng = doglove_hand(side), doglove_linkage(), np.random.default_rng(2)
    mirror = np.array([1.0, -1.0 if side == "left" else 1.0, 1.0])
    angles = rng.uniform(-0.4, 0.8, 21)
    forces = rng.normal(size=(5, 3))
    frames = pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(angles)))
    torques = model.resisting(hand.joints, np.asarray(joint_torques(hand, frames, caps(hand, angles), forces)))
    step = 1e-6
    for k in range(21):
        turned = step * (np.arange(21) == k)
        moved = published_tips(to_urdf(angles + turned)) - published_tips(to_urdf(angles - turned))
        # tau dq = f . dp: a channel resists flexion by what the caps' forces on the object do as it flexes.
        work = np.sum(forces * (moved @ FRAME.T * mirror)) / (2 * step)
        assert torques[k] == pytest.approx(work, abs=1e-6), model.joints[k]
    np.testing.assert_allclose(caps(hand, angles), caps(HAND, angles) * mirror, atol=1e-12)
    with_motor = [joint for joint, limit in zip(model.joints, model.limits) if limit]
    assert with_motor == ["thumb CM", *(f"{finger} MP" for finger in FINGERS[1:])]


def test_a_servo_turns_what_its_bar_carries_towards_the_palm():
    angles = linkage_angles(HAND, human_hand(), closing_kinematics(human_hand()).open)
    for finger, joint in zip(FINGERS, ("thumb CM", *(f"{finger} MP" for finger in FINGERS[1:]))):
        flexed = angles + 0.1 * np.array([name == joint for name in HAND.joints])
        change = (caps(HAND, flexed) - caps(HAND, angles))[FINGERS.index(finger)]
        assert change[2] < -0.003 if finger != "thumb" else np.linalg.norm(change) > 0.003, finger


@pytest.mark.parametrize("length", [0.17, 0.19, 0.21])
def test_caps_reach_the_fingertips_of_hands_of_any_size(length):
    person = human_hand(length)
    closing = closing_kinematics(person)
    rows = [[link.name for link in person.links].index(link.name) for link in HAND.links]
    for share in (0.0, 0.5, 1.0):
        person_angles = closing.open + share * (closing.closed - closing.open)
        links = pose_hand(person, Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(person_angles))).links
        tips = np.asarray(links.origin + jnp.einsum("lij,lj->li", links.rotation, person.skin.centers[:, -1]))[rows]
        angles = linkage_angles(HAND, person, person_angles)
        np.testing.assert_allclose(caps(HAND, angles), tips, atol=1e-4)
        assert np.all((angles >= HAND.lower) & (angles <= HAND.upper))


def test_arguments_that_no_linkage_has(unchecked):
    for arguments, message in (
        ({"side": "both"}, "side is 'both': expected 'right' or 'left'"),
        ({"cap_radius": 0.0}, "cap_radius is 0.0: expected a positive number"),
        ({"wrist": (0.0, math.nan, 0.0)}, "wrist is .*: expected three finite numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            doglove_hand(**arguments)


def test_mujoco_has_the_caps_in_the_same_places():
    mujoco = pytest.importorskip("mujoco")
    bodies = ""
    for finger in FINGERS:
        *joints, tip = CHAINS[finger]
        inner = f'<site name="{finger}" pos="{" ".join(map(str, tip))}"/>'
        for k, (origin, turn, axis) in reversed(list(enumerate(joints))):
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, _rotation(turn).ravel())
            inner = (
                f'<body pos="{" ".join(map(str, origin))}" quat="{" ".join(map(str, quaternion))}">'
                f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
                f'<joint name="{finger}{k}" axis="{" ".join(map(str, axis))}"/>{inner}</body>'
            )
        bodies += inner
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler autolimits="false"/><worldbody>{bodies}</worldbody></mujoco>'
    )
    data, angles = mujoco.MjData(model), np.random.default_rng(3).uniform(HAND.lower, HAND.upper)
    for finger, turns in to_urdf(angles).items():
        for k, angle in enumerate(turns):
            data.joint(f"{finger}{k}").qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    places = np.array([data.site(finger).xpos for finger in FINGERS])
    np.testing.assert_allclose(caps(HAND, angles), places @ FRAME.T + [0.008, -0.090642, -0.02], atol=4e-6)


def _rotation(turn) -> np.ndarray:
    roll, pitch, yaw = turn
    return (about((0, 0, 1), yaw) @ about((0, 1, 0), pitch) @ about((1, 0, 0), roll))[:3, :3]
