"""Joints that slide, and bodies without joints: the same laws as for hands of hinges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp, Verdict, constrained_optimum, weight_wrench
from jaxgrasp.hand import (
    Box,
    Hand,
    Link,
    Pose,
    Posture,
    Sphere,
    Spheres,
    close_hand,
    contact_jacobian,
    find_contacts,
    grasp_from_contacts,
    joint_torques,
    mirrored,
    parallel_jaw,
    pose_hand,
)
from tests.hand.hands import random_posture, rotations

JAW = parallel_jaw()
RIGID = Hand(
    origins=jnp.zeros((0, 3)),
    rests=jnp.zeros((0, 3, 3)),
    axes=jnp.zeros((0, 3)),
    lower=jnp.zeros(0),
    upper=jnp.zeros(0),
    skin=Spheres(jnp.array([[[0.0, 0, 0]], [[0.1, 0, 0]]]), jnp.full((2, 1), 0.02)),
    parents=(),
    joints=(),
    links=(Link("near", "", -1), Link("far", "", -1)),
)


def mixed() -> Hand:
    """Return a hand of a hinge that carries a slide that carries a hinge."""
    turns = jnp.asarray(rotations(3, np.random.default_rng(0)))
    return Hand(
        origins=jnp.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.03, 0]]),
        rests=turns,
        axes=turns[:, 0],
        lower=jnp.array([-1.0, -0.1, -1.0]),
        upper=jnp.array([1.0, 0.1, 1.0]),
        skin=Spheres(jnp.full((3, 1, 3), 0.01), jnp.full((3, 1), 0.01)),
        parents=(-1, 0, 1),
        joints=("base", "rail", "tip"),
        links=(Link("base", "", 0), Link("rail", "", 1), Link("tip", "", 2)),
        sliding=("rail",),
    )


def test_a_point_moves_as_its_jacobian_says():
    hand, posture = mixed(), random_posture(mixed(), 5)
    local = np.random.default_rng(1).normal(scale=0.05, size=(3, 3))

    def points(angles):
        links = pose_hand(hand, Posture(posture.wrist, angles)).links
        return jnp.einsum("...lij,lj->...li", links.rotation, local) + links.origin

    angles = jnp.asarray(posture.angles)
    jacobian = jax.jacfwd(points)(angles)
    by_autodiff = np.stack([jacobian[i, :, :, i] for i in range(5)])
    closed = contact_jacobian(hand, pose_hand(hand, posture), points(angles))
    np.testing.assert_allclose(closed, by_autodiff, atol=1e-14)
    assert np.all(np.asarray(closed)[:, 0, :, 1:] == 0) and np.any(np.asarray(closed)[:, 2, :, 1] != 0)


def test_joint_forces_do_the_work_of_the_contacts():
    hand, posture = mixed(), random_posture(mixed(), 5)
    rng = np.random.default_rng(2)
    frames = pose_hand(hand, posture)
    points = frames.links.origin + rng.normal(scale=0.03, size=(5, 3, 3))
    forces = rng.normal(size=(5, 3, 3))
    expected = np.einsum("blcj,blc->bj", contact_jacobian(hand, frames, points), -forces)
    np.testing.assert_allclose(joint_torques(hand, frames, points, forces), expected, atol=1e-14)


def test_a_mirrored_slide_slides_as_the_mirror_shows():
    hand, posture = mixed(), random_posture(mixed(), 4)
    flip = np.diag([1.0, -1.0, 1.0])
    image = Posture(Pose(posture.wrist.origin @ flip, flip @ posture.wrist.rotation @ flip), posture.angles)
    ours, theirs = pose_hand(hand, posture).links, pose_hand(mirrored(hand), image).links
    np.testing.assert_allclose(theirs.origin, ours.origin @ flip, atol=1e-14)


def test_jaws_close_on_what_stands_between_them():
    """Not in the middle: each jaw stops where it meets the box."""
    placed = Pose(np.array([0.006, 0.0, 0.1]), np.eye(3))
    start = Posture(Pose(np.zeros(3), np.eye(3)), np.zeros(2))
    closed, contacts = close_hand(JAW, start, Box(0.03, 0.04, 0.05), placed, 5e-4, steps=400)
    np.testing.assert_allclose(contacts.present, 1)
    np.testing.assert_allclose(contacts.depths, 5e-4, atol=1.01e-4)
    np.testing.assert_allclose(contacts.points[:, 0], [0.021] * 4 + [-0.009] * 4, atol=1e-12)
    np.testing.assert_allclose(contacts.normals, [[-1, 0, 0]] * 4 + [[1, 0, 0]] * 4, atol=1e-12)
    # Every part touches in a corner of its own.
    corners = np.sign(np.asarray(contacts.points) - [0, 0, 0.10315])[:, 1:]
    np.testing.assert_array_equal(corners, [[-1, -1], [-1, 1], [1, -1], [1, 1]] * 2)
    np.testing.assert_allclose(closed.angles, [0.04 - 0.021, 0.04 - 0.009], atol=7e-4)


@pytest.mark.parametrize("ways", [(0.0, 0.0), (0.3, -0.25)])
def test_what_slides_is_within_reach_wherever_it_slid(ways):
    """Even beyond its limits."""
    start = Posture(Pose(np.zeros(3), np.eye(3)), np.array(ways))
    pad = np.asarray(pose_hand(JAW, start).links.origin)[0] + [0, 0, 0.1]
    assert find_contacts(JAW, start, Sphere(0.01), Pose(pad, np.eye(3))).present[:4].any()


def test_a_body_without_joints_has_contacts_but_nothing_to_turn():
    posture = Posture(Pose(np.zeros((4, 3)), rotations(4, np.random.default_rng(0))), np.zeros((4, 0)))
    far = posture.wrist.rotation[..., 0] * 0.1
    contacts = find_contacts(RIGID, posture, Sphere(0.03), Pose(far + [0, 0, 0.045], posture.wrist.rotation))
    np.testing.assert_array_equal(contacts.present, [[0, 1]] * 4)
    np.testing.assert_allclose(contacts.depths[:, 1], 0.005, atol=1e-12)
    assert joint_torques(RIGID, pose_hand(RIGID, posture), contacts.points, contacts.normals).shape == (4, 0)


@pytest.mark.parametrize(
    "sizes, words", [({"opening": 0.0}, "opening is 0"), ({"radius": 0.011}, "at most half of the pads' sides")]
)
def test_jaws_of_no_size_are_refused(sizes, words):
    with pytest.raises(ValueError, match=words):
        parallel_jaw(**sizes)


@pytest.mark.slow
def test_flat_pads_keep_a_box_from_turning():
    """Flat pads resist the turning that one point of contact on each side could not."""
    placed = Pose(np.array([0.0, 0.0, 0.12]), np.eye(3))
    start = Posture(Pose(np.zeros(3), np.eye(3)), np.zeros(2))
    _, contacts = close_hand(JAW, start, Box(0.03, 0.04, 0.06), placed, 2e-3, steps=400)
    grasp = grasp_from_contacts(contacts, 0.5, 2000.0)
    # Its weight acts beside the line between the pads.
    wrench = weight_wrench(0.2, placed.origin, jnp.array([0.0, -9.81, 0.0]))
    assert constrained_optimum(grasp, wrench).verdict <= Verdict.OPTIMAL
    middle = jnp.stack([jnp.mean(grasp.points[:4], 0), jnp.mean(grasp.points[4:], 0)])
    points = Grasp(middle, grasp.normals[::4], grasp.friction[::4], grasp.squeeze[::4])
    assert constrained_optimum(points, wrench).verdict == Verdict.INFEASIBLE
