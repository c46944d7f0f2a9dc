"""Stability of stacks: the load on each level, the limits of tipping and sliding, and proofs that a stack falls."""

import equinox as eqx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.hand import Box, Cylinder, Sphere, sphere_tree
from jaxgrasp.world import stands
from jaxgrasp.world.many_bodies import HAND, OBSTACLES, TABLE
from tests.world.worlds import BLOCK, G, some_turn, tower, world_with


def proves_a_fall(world, centers, standing) -> bool:
    """Check Farkas' lemma on the contacts' numbers: gravity works along the motion, no force of a cone against it."""
    motion, gravity = standing.certificate, np.asarray(world.scene.gravity)
    masses = np.array([body.body.mass for body in world.bodies])
    work = float(masses @ (motion[:, :3] @ gravity))
    contacts = standing.contacts
    rate = np.zeros_like(contacts.points)
    for sign, owner in ((1, contacts.first), (-1, contacts.second)):
        is_loaded = owner >= 0
        arms = contacts.points[is_loaded] - centers[owner[is_loaded]]
        rate[is_loaded] += sign * (motion[owner[is_loaded], :3] + np.cross(motion[owner[is_loaded], 3:], arms))
    along = np.einsum("mi,mi->m", rate, contacts.normals)
    across = np.linalg.norm(rate - along[:, None] * contacts.normals, axis=1)
    # The most that a force of unit normal part could take from the motion's work.
    resisting = np.maximum(contacts.friction * across - along, 0)
    return work > 0 and float(resisting.max(initial=0)) <= 1e-5 * np.abs(rate).max()


@pytest.mark.parametrize("seed", range(2))
def test_each_level_carries_what_is_above_it(seed):
    masses = np.random.default_rng(seed).uniform(0.1, 2, 4).tolist()
    world, state = tower(masses, 0.2)
    standing = stands(world, state.placed)
    assert standing.stands and standing.proved
    total_weight = G * sum(masses)
    assert standing.loads.by_table[0, 2] == pytest.approx(total_weight, abs=1e-9 * total_weight)
    for k in range(3):
        up, down = standing.loads.by_bodies[k + 1, k], standing.loads.by_bodies[k, k + 1]
        np.testing.assert_allclose(up[:3], [0, 0, G * sum(masses[k + 1 :])], atol=1e-9 * total_weight)
        np.testing.assert_allclose(down[:3], -up[:3], atol=1e-12 * total_weight)
    # Nothing is left of any object's weight, moments included; and all forces are in their cones.
    np.testing.assert_allclose(standing.residual, 0, atol=1e-9 * total_weight)
    along = np.einsum("mi,mi->m", standing.forces, standing.contacts.normals)
    across = np.linalg.norm(standing.forces - along[:, None] * standing.contacts.normals, axis=1)
    assert np.all(across <= standing.contacts.friction * along + 1e-9 * total_weight)


@pytest.mark.parametrize("overhang", [0.0, 0.25, 0.45, 0.49, 0.51, 0.55, 0.9])
def test_a_block_that_stands_out_beyond_half_falls(overhang):
    world, state = tower([0.3, 0.2, 0.4], overhang)
    standing = stands(world, state.placed)
    assert standing.proved and standing.stands == (overhang < 0.5)
    if not standing.stands:
        assert proves_a_fall(world, state.placed.origin, standing)
        # It turns about the edge, the way that the weight pulls.
        assert standing.certificate[1, 4] > 0


@pytest.mark.parametrize("rubbing", [0.3, 0.45, 0.49, 0.51, 0.6])
def test_a_block_slides_on_another_where_the_slope_exceeds_the_friction(rubbing):
    """A slope of 1 in 2, as gravity turned: the lower block is too heavy and broad to tip."""
    slope = np.arctan(0.5)
    gravity = (G * np.sin(slope), 0.0, -G * np.cos(slope))
    world, state = tower([3.0, 0.1], gravity=gravity, rubbing=rubbing)
    standing = stands(world, state.placed)
    assert standing.proved and standing.stands == (rubbing > 0.5)


def test_turning_the_world_turns_the_answer():
    turn = some_turn(3)
    plain, turned = (stands(w, s.placed) for w, s in (tower([0.2, 0.5], 0.3), tower([0.2, 0.5], 0.3, frame=turn)))
    for name in ("by_table", "by_bodies"):
        loads, turned_loads = (getattr(standing.loads, name) for standing in (plain, turned))
        for part in (slice(3), slice(3, 6)):
            np.testing.assert_allclose(turned_loads[..., part], loads[..., part] @ turn.T, atol=1e-6)


def test_the_order_of_the_objects_does_not_matter():
    shapes, masses = [BLOCK, Sphere(0.02), Cylinder(0.02, 0.04)], [0.3, 0.2, 0.1]
    centers = np.array([[0, 0, 0.02], [-0.015, 0, 0.06], [0.01, 0.0, 0.06]]) + [[0, 0, 0], [-0.005, 0, 0], [0.01, 0, 0]]
    order = [2, 0, 1]
    world, state = world_with(shapes, centers, masses)
    reordered, moved = world_with([shapes[k] for k in order], centers[order], [masses[k] for k in order])
    standing, another = stands(world, state.placed), stands(reordered, moved.placed)
    assert standing.stands and another.stands
    np.testing.assert_allclose(another.loads.by_table, standing.loads.by_table[order], atol=1e-6)
    np.testing.assert_allclose(another.loads.by_bodies, standing.loads.by_bodies[np.ix_(order, order)], atol=1e-6)


@pytest.mark.parametrize(("rubbing", "holds"), [(0.25, False), (0.26, False), (0.275, True), (0.4, True)])
def test_a_pile_of_three_logs_stands_by_its_friction(rubbing, holds):
    """A log on two others that touch needs a friction of tan 15 degrees between them, a known result."""
    log, radius = Cylinder(0.02, 0.06), 0.02
    centers = radius * np.array([[-1, 0, 1], [1, 0, 1], [0, 0, 1 + np.sqrt(3)]])
    turns = np.broadcast_to(Rotation.from_rotvec([np.pi / 2, 0, 0]).as_matrix(), (3, 3, 3))
    world, state = world_with([log] * 3, centers, [0.2] * 3, rubbing=rubbing, turns=turns)
    standing = stands(world, state.placed)
    assert standing.proved and standing.stands == holds == (rubbing > np.tan(np.radians(15)))
    assert holds or proves_a_fall(world, state.placed.origin, standing)


def test_nothing_touches_and_all_falls():
    world, state = world_with([Sphere(0.02)], np.array([[0, 0, 1.0]]), [0.1])
    standing = stands(world, state.placed)
    assert not standing.stands and not len(standing.forces)
    np.testing.assert_allclose(standing.certificate[0], [0, 0, -G, 0, 0, 0], atol=1e-12)
    assert {HAND, TABLE, OBSTACLES}.isdisjoint(standing.contacts.second.tolist())


@pytest.mark.slow
def test_a_mesh_out_of_its_principal_frame_is_refused():
    world, state = tower([0.1])
    tree = sphere_tree(Box(0.04, 0.04, 0.04), 2)
    askew = eqx.tree_at(lambda t: t.moments, tree, np.full(3, np.nan))
    with pytest.raises(ValueError, match="object 0 has moments of inertia .*: expected a mesh in its principal_frame"):
        stands(eqx.tree_at(lambda w: w.scene.body.shape, world, askew), state.placed)


def test_an_inertia_that_engines_would_leave_out_is_refused():
    world, state = tower([0.2, 0.3])
    others = eqx.tree_at(lambda w: w.others[0].body.inertia, world, 1e-4 * np.eye(3), is_leaf=lambda x: x is None)
    with pytest.raises(
        ValueError, match="object 1 has its own inertia tensor: expected a uniform density among several objects"
    ):
        stands(others, state.placed)
