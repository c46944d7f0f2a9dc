"""Objects against tables, obstacles and each other: the same contacts from either side, and the wrench they exert."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import weight_wrench
from jaxgrasp.hand import (
    Box,
    Capsule,
    Cylinder,
    Plane,
    Pose,
    Sphere,
    rigid_body,
    sphere_tree,
    spring_wrench,
    world_contacts,
)
from tests.hand.hands import rotations

BOX = Box(0.06, 0.08, 0.05)
GROUND = Pose(np.zeros(3), np.eye(3))


@pytest.fixture(scope="module")
def box():
    return rigid_body(sphere_tree(BOX, 4))


def test_a_box_stands_on_a_table_by_four_contacts(box):
    placed = Pose(np.array([0.3, -0.2, 0.024]), np.eye(3))
    contacts = world_contacts(box, placed, Plane(), GROUND)
    assert box.links[0].name == "-x-y-z" and box.links[7].name == "+x+y+z"
    np.testing.assert_array_equal(contacts.present, [1, 0] * 4)
    np.testing.assert_allclose(contacts.depths, [0.001, 0] * 4, atol=1e-9)
    is_present = np.asarray(contacts.present) > 0
    np.testing.assert_allclose(np.asarray(contacts.normals)[is_present], [[0, 0, 1]] * 4, atol=1e-12)
    np.testing.assert_allclose(np.asarray(contacts.points)[is_present, 2], 0, atol=1e-12)
    np.testing.assert_allclose(np.mean(np.asarray(contacts.points)[is_present], 0), [0.3, -0.2, 0], atol=1e-9)


def test_where_springs_carry_it_the_hand_need_not(box):
    """Four springs, each a quarter of the weight: the sum of both wrenches is nothing, about any point."""
    mass, stiffness = 0.5, 2e3
    depth = mass * 9.81 / (4 * stiffness)
    placed = Pose(np.array([0.3, -0.2, 0.025 - depth]), np.eye(3))
    contacts = world_contacts(box, placed, Plane(), GROUND)
    for about in (placed.origin, np.array([0.1, 0.2, 0.3])):
        needed = weight_wrench(mass, placed.origin - about, jnp.array([0.0, 0.0, -9.81]))
        np.testing.assert_allclose(spring_wrench(contacts, stiffness, about), needed, atol=1e-9)


@pytest.mark.parametrize("obstacle", [Sphere(0.04), Cylinder(0.03, 0.1), Capsule(0.02, 0.08)])
def test_contacts_move_with_both(box, obstacle):
    rng = np.random.default_rng(0)
    placed = Pose(rng.normal(scale=0.03, size=(20, 3)), rotations(20, rng))
    at = Pose(np.array([0.01, 0.02, -0.05]), rotations(1, rng)[0])
    turn, shift = rotations(1, rng)[0], np.array([0.5, -0.3, 0.2])
    contacts = world_contacts(box, placed, obstacle, at)
    moved = world_contacts(
        box,
        Pose(placed.origin @ turn.T + shift, turn @ placed.rotation),
        obstacle,
        Pose(turn @ at.origin + shift, turn @ at.rotation),
    )
    assert contacts.present.mean() > 0.1
    np.testing.assert_allclose(moved.depths, contacts.depths, atol=1e-12)
    is_present = np.asarray(contacts.present)[..., None]
    np.testing.assert_allclose(moved.points * is_present, (contacts.points @ turn.T + shift) * is_present, atol=1e-12)
    np.testing.assert_allclose(moved.normals * is_present, contacts.normals @ turn.T * is_present, atol=1e-9)


@pytest.mark.slow
def test_two_trees_press_each_other_alike():
    """Deepest overlap and its direction, seen from either side."""
    trees = sphere_tree(BOX, 4), sphere_tree(Sphere(0.04), 4)
    places = Pose(np.zeros(3), np.eye(3)), Pose(np.array([0.003, 0.002, 0.0635]), np.eye(3))
    ours = world_contacts(rigid_body(trees[0]), places[0], trees[1], places[1])
    theirs = world_contacts(rigid_body(trees[1]), places[1], trees[0], places[0])
    assert ours.present.sum() > 0 and theirs.present.sum() > 0
    for contacts, side in ((ours, -1), (theirs, 1)):
        deepest = int(np.argmax(contacts.depths))
        np.testing.assert_allclose(contacts.normals[deepest], [0, 0, side], atol=0.15)
        assert 0.0002 < contacts.depths[deepest] < 0.0016


def test_derivatives_by_the_objects_pose(box):
    placed = Pose(jnp.array([0.3, -0.2, 0.024]), jnp.asarray(rotations(1, np.random.default_rng(1))[0]))
    tilt = Pose(jnp.array([0.3, -0.2, 0.03]), placed.rotation)

    def energy(origin):
        return spring_wrench(world_contacts(box, Pose(origin, tilt.rotation), Plane(), GROUND), 1e3, tilt.origin)

    forward, reverse = jax.jacfwd(energy)(tilt.origin), jax.jacrev(energy)(tilt.origin)
    np.testing.assert_allclose(forward, reverse, atol=1e-9)
    step = 1e-7
    sides = [energy(tilt.origin.at[2].add(s * step)) for s in (1, -1)]
    np.testing.assert_allclose(forward[:, 2], (sides[0] - sides[1]) / (2 * step), rtol=1e-5, atol=1e-4)
