"""Force on the wrist: with the joints' it does the object's work, and the device bounds and drops what it renders."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.hand import human_hand, joint_torques, pose_hand
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.teleop.feedback import shared_forces
from jaxgrasp.teleop.wrist import FORCE_LIMIT, MAX_SILENCE, RATES, SimulatedWrist, wrist_wrench

MASS, INERTIA, G = 0.3, 2e-4, 9.81
STEP, COUNT = 1e-3, 900
TIMES = STEP * np.arange(COUNT)


def smooth(times):
    s = np.clip(times / TIMES[-1], 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


MOTIONS = {
    "lift": (0.2 * smooth(TIMES), 0.3 * smooth(TIMES), 0.5 * smooth(TIMES)),
    "shake": (0.03 * np.sin(12 * TIMES) * smooth(TIMES), 0.2 * np.sin(9 * TIMES), 0.15 * np.sin(15 * TIMES)),
    "collision": (-0.15 * smooth(TIMES), 0.1 * np.sin(5 * TIMES), 0.2 * smooth(TIMES)),
}
"""Height of the wrist, its turn, and the flexion of the finger, over time."""


def rates(values):
    return np.gradient(values, STEP, axis=0)


@pytest.mark.parametrize("kind", MOTIONS)
def test_joints_and_wrist_do_the_objects_work(kind):
    """A ball on the index fingertip: wrist and finger both move it, against gravity, inertia and a springy wall."""
    hand = human_hand()
    height, turn, flexion = MOTIONS[kind]
    angles = np.full((COUNT, len(hand.joints)), 0.2)
    angles[:, [hand.joints.index(f"index {joint}") for joint in ("MP", "PIP", "DIP")]] += flexion[:, None]
    origin = np.stack([0.05 * turn, 0 * turn, height], -1)
    rotation = Rotation.from_rotvec(turn[:, None] * [0.3, 0.8, -0.5])
    frames = pose_hand(hand, Posture(Pose(origin, rotation.as_matrix()), angles))
    link = [k.name for k in hand.links].index("index distal")
    place = np.asarray(frames.links.origin)[:, link]
    axes = np.asarray(frames.links.rotation)[:, link]
    centre = place + axes @ np.array([0.01, 0.0, -0.04])
    spots = np.array([[0.02, 0.01, -0.01], [-0.01, 0.0, -0.01], [0.01, -0.012, -0.01]])
    velocity, spin = rates(centre), rates_of_rotation(Rotation.from_matrix(axes))
    wall = np.zeros((COUNT, 3))
    if kind == "collision":
        # A floor of 3000 N/m that the ball dips into half-way.
        wall[:, 2] = 3000 * np.maximum(centre[COUNT // 2, 2] - centre[:, 2], 0)
    load_force = MASS * (rates(velocity) + [0, 0, G]) - wall
    load = np.concatenate([load_force, INERTIA * rates(spin)], -1)
    touched = place[:, None] + spots @ np.swapaxes(axes, 1, 2)
    arms = touched - centre[:, None]
    normals = -arms / np.linalg.norm(arms, axis=-1, keepdims=True)
    shared = np.array([shared_forces(*row, np.full(3, 2.0), w) for *row, w in zip(arms, normals, load, strict=True)])
    speeds, twist = rates(angles), np.concatenate([rates(origin), rates_of_rotation(rotation)], -1)
    joint_power = np.zeros(COUNT)
    for spot in range(3):
        points, forces = np.zeros((2, COUNT, len(hand.links), 3))
        points[:, link], forces[:, link] = touched[:, spot], shared[:, spot]
        joint_power -= np.sum(np.asarray(joint_torques(hand, frames, points, forces)) * speeds, -1)
    reactions = np.array([wrist_wrench(*row) for row in zip(touched, shared, origin, strict=True)])
    wrist_power = -np.sum(reactions * twist, -1)
    energy = 0.5 * MASS * np.sum(velocity**2, -1) + 0.5 * INERTIA * np.sum(spin**2, -1) + MASS * G * centre[:, 2]
    wall_work = np.sum(wall * velocity, -1)
    inside = slice(3, -3)
    done = np.trapezoid((joint_power + wrist_power + wall_work)[inside], dx=STEP)
    change = energy[inside][-1] - energy[inside][0]
    exchanged = np.trapezoid(np.abs(rates(energy))[inside], dx=STEP)
    assert done == pytest.approx(change, abs=0.01 * exchanged)
    # Each part matters: neither alone is the whole work.
    for part in (joint_power, wrist_power):
        assert abs(np.trapezoid((part + wall_work)[inside], dx=STEP) - change) > 0.02 * exchanged


def rates_of_rotation(rotation):
    spin = np.zeros((COUNT, 3))
    spin[1:-1] = (rotation[2:] * rotation[:-2].inv()).as_rotvec() / (2 * STEP)
    spin[0], spin[-1] = spin[1], spin[-2]
    return spin


def test_the_wrench_is_the_contacts_reaction_about_the_wrist():
    wrench = wrist_wrench(np.array([[0.1, 0, 0.5]]), np.array([[0, 0, 2.0]]), np.array([0, 0, 0.5]))
    assert wrench == pytest.approx([0, 0, -2, 0, 0.2, 0])


def test_the_device_bounds_size_and_rate_and_falls_silent():
    device = SimulatedWrist()
    device.read(0.0)
    last = np.zeros(6)
    for k in range(1, 400):
        device.command(k * STEP, np.array([100.0, -3, 0, 0, 0.1, -50]))
        now = device.read(k * STEP)
        assert np.all(np.abs(now - last) <= np.array(RATES) * STEP + 1e-12)
        last = now
    assert last == pytest.approx([FORCE_LIMIT, -3, 0, 0, 0.1, -2])
    assert device.read(0.399 + MAX_SILENCE - STEP) == pytest.approx(last)
    assert not device.read(0.399 + MAX_SILENCE + STEP).any()
    device.command(0.5, np.ones(6))
    assert device.read(0.5).any()
    device.command(0.5 + STEP, np.zeros(6))
    assert not device.read(0.5 + STEP).any()


def test_the_device_stops_and_is_released():
    device = SimulatedWrist()
    device.read(0.0)
    device.command(0.01, np.ones(6))
    assert device.read(0.01).any()
    device.command(0.02, np.full(6, np.nan))
    assert not device.read(0.02).any() and "not finite" in device.cause
    device.command(0.03, np.ones(6))
    assert not device.read(0.03).any()
    device.release()
    device.command(0.04, np.ones(6))
    assert device.read(0.041).any()
    with pytest.raises(ValueError, match="force_limit is"):
        SimulatedWrist(force_limit=0.0)
