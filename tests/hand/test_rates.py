"""Derivatives of frames and contacts by the joint angles: those of the functions themselves, by central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.hand import Box, Pose, Posture, find_contacts, parallel_jaw, pose_hand
from jaxgrasp.hand.detection import contacts_and_rates
from jaxgrasp.hand.kinematics import frame_rates
from tests.hand.hands import rotations
from tests.hand.test_detection import HAND, each_shape, scenes

STEP = 1e-6


def by_differences(function, posture):
    """Return the function at the posture, and its derivatives by the angles as a first axis, in one batched call."""
    joints = posture.angles.size
    moved = posture.angles + STEP * np.concatenate([np.zeros((1, joints)), np.eye(joints), -np.eye(joints)])
    wrist = Pose(*(jnp.broadcast_to(x, (len(moved), *x.shape)) for x in (posture.wrist.origin, posture.wrist.rotation)))
    values = jax.device_get(function(Posture(wrist, jnp.asarray(moved))))
    rates = jax.tree.map(lambda x: (x[1 : joints + 1].astype(float) - x[joints + 1 :]) / (2 * STEP), values)
    return jax.tree.map(lambda x: x[0], values), rates


def jaws():
    """Return a gripper whose fingers slide, half closed."""
    hand = parallel_jaw()
    angles = jnp.full(len(hand.joints), 0.02)
    rotation = rotations(1, np.random.default_rng(3))[0]
    return hand, Posture(Pose(jnp.array([0.1, -0.2, 0.3]), jnp.asarray(rotation)), angles)


@pytest.mark.parametrize("name", ["fingers", "jaws"])
def test_rates_of_frames_are_those_of_the_posed_hand(name):
    if name == "jaws":
        hand, posture = jaws()
    else:
        hand, posture = HAND, jax.tree.map(lambda x: jnp.asarray(x[0]), scenes(1)[0])
    frames, expected = by_differences(lambda p: pose_hand(hand, p), posture)
    rates = frame_rates(hand, frames)
    for part, other in zip(jax.tree.leaves(rates), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(part, other, atol=1e-8)


@each_shape
def test_rates_of_contacts_are_those_of_the_detection(shape):
    """For one posed hand and several places of the object, some of them out of reach."""
    postures, placed = scenes(40, seed=4)
    touching = np.asarray(find_contacts(HAND, postures, shape, placed).present).sum(-1)
    chosen = int(np.argmax(touching))
    posture = jax.tree.map(lambda x: jnp.asarray(x[chosen]), postures)
    object_pose = jax.tree.map(lambda x: jnp.asarray(x[chosen]), placed)
    far = object_pose.origin + jnp.array([0.0, 0.0, 3.0])
    places = Pose(
        jnp.stack([object_pose.origin, far, object_pose.origin + 1e-3]), jnp.stack([object_pose.rotation] * 3)
    )
    contacts, rates = jax.jit(contacts_and_rates)(HAND, pose_hand(HAND, posture), shape, places)
    assert contacts.present[0].sum() >= 3
    for row in range(3):
        place = jax.tree.map(lambda x, row=row: x[row], places)
        found, expected = by_differences(lambda p, place=place: find_contacts(HAND, p, shape, place), posture)
        for name in ("points", "normals", "depths", "present"):
            np.testing.assert_allclose(getattr(contacts, name)[row], getattr(found, name), atol=1e-12)
        for name in ("points", "normals", "depths"):
            np.testing.assert_allclose(getattr(rates, name)[:, row], getattr(expected, name), atol=1e-5, rtol=1e-5)


def test_rates_of_sliding_jaws_are_those_of_the_detection():
    hand, posture = jaws()
    frames = pose_hand(hand, posture)
    middle = posture.wrist.origin + posture.wrist.rotation @ jnp.array([0.0, 0.0, 0.1])
    # The fingers are 40 mm apart and touch its sides, each with four parts.
    box, placed = Box(0.045, 0.05, 0.06), Pose(middle, posture.wrist.rotation)
    contacts, rates = contacts_and_rates(hand, frames, box, placed)
    assert contacts.present.sum() == 8
    _, expected = by_differences(lambda p: find_contacts(hand, p, box, placed), posture)
    for name in ("points", "normals", "depths"):
        np.testing.assert_allclose(getattr(rates, name), getattr(expected, name), atol=1e-6)
