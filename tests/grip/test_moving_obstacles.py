"""Moving obstacles, their friction and damping, and obstacles that stop the hand: each against a balance of its own."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Body, Obstacle, Scene, observe, simulate
from jaxgrasp.grip.motion import Motion
from jaxgrasp.grip.obstacles import hand_torques, world_wrench
from jaxgrasp.grip.scene import ObstaclePath, at_time
from jaxgrasp.hand import (
    Box,
    Plane,
    Pose,
    Posture,
    find_contacts,
    human_hand,
    parallel_jaw,
    pose_hand,
    rigid_body,
    sphere_tree,
)
from tests.grip.hands import without_hand
from tests.hand.hands import rotations

SHAPE, MASS, DT = Box(0.06, 0.08, 0.05), 0.5, 5e-3
WORLD = Pose(jnp.zeros(3), jnp.eye(3))
RISING = ObstaclePath(np.array([0.1, 0.4, 0.5]), np.array([[0, 0, 0], [0.02, 0, 0.03], [0, 0, 0.1]]), np.zeros((3, 3)))


@pytest.fixture(scope="module")
def outline():
    return rigid_body(sphere_tree(SHAPE, 4))


def scene(outline, *obstacles: Obstacle, hand=None, **more) -> Scene:
    hand = parallel_jaw() if hand is None else hand
    table = Pose(jnp.array([0.0, 0.0, -0.6]), jnp.eye(3))
    links, gravity = jnp.ones(len(hand.links)), jnp.array([0.0, 0.0, -9.81])
    return Scene(hand, Body(SHAPE, MASS), table, 0.5, 2e3, links, gravity, obstacles=obstacles, outline=outline, **more)


def test_an_obstacle_moves_as_its_path_does(outline):
    """Places by hand, velocities by differences, of a path that turns."""
    turns = np.array([[0, 0, 0], [0.4, -0.2, 0.3], [0.4, -0.2, 0.3]])
    path = ObstaclePath(RISING.times, RISING.shifts, turns)
    start = Pose(jnp.array([0.1, 0.2, 0.3]), jnp.asarray(rotations(1, np.random.default_rng(0))[0]))
    world = scene(outline, Obstacle(SHAPE, start, 1e3, path=path))
    place = jax.jit(lambda time: at_time(world, time).obstacles[0])
    for time, shift, turn in ((0.0, [0, 0, 0], 0), (0.25, [0.01, 0, 0.015], 0.5), (0.45, [0.01, 0, 0.065], 1)):
        obstacle = place(time)
        np.testing.assert_allclose(obstacle.placed.origin, start.origin + np.array(shift), atol=1e-15)
        turned = Rotation.from_rotvec(turn * turns[1]).as_matrix() @ start.rotation
        np.testing.assert_allclose(obstacle.placed.rotation, turned, atol=1e-14)
        before, after = place(time - 1e-5), place(time + 1e-5)
        linear = (after.placed.origin - before.placed.origin) / 2e-5
        spin = Rotation.from_matrix(after.placed.rotation @ before.placed.rotation.T).as_rotvec() / 2e-5
        np.testing.assert_allclose(obstacle.motion.linear, linear, atol=1e-8)
        np.testing.assert_allclose(obstacle.motion.angular, spin, atol=1e-8)
        # Whoever asks again of what is there moves it no further.
        moved_world = at_time(world, time)
        jax.tree.map(np.testing.assert_array_equal, at_time(moved_world, 0.3).obstacles, moved_world.obstacles)
    for time in (-1.0, 9.0):
        assert not np.any(place(time).motion.linear) and not np.any(place(time).motion.angular)


def test_what_rubs_and_dampens_resists_what_moves_and_never_pulls(outline):
    """A box, its underside 1 mm deep in a plane: four corners, each K d + c v; friction is mu times that."""
    turn = jnp.asarray(rotations(1, np.random.default_rng(1))[0])
    floor = Obstacle(Plane(), Pose(jnp.zeros(3), turn), 2e3, friction=0.4, damping=30.0)
    placed = Pose(turn @ jnp.array([0.0, 0.0, 0.024]), turn)
    push = jax.jit(lambda velocity: world_wrench(scene(outline, floor), placed, Motion(velocity, jnp.zeros(3))))
    for along, across in ((0.0, 0.0), (-0.02, 0.3), (0.01, 0.3), (1.0, 0.3)):
        pressed = 4 * max(2e3 * 1e-3 - 30 * along, 0)
        force = np.asarray(turn.T @ push(turn @ jnp.array([0.6 * across, -0.8 * across, along]))[:3])
        np.testing.assert_allclose(force[2], pressed, rtol=1e-6, atol=1e-9)
        rubbed = 0.4 * pressed * np.array([-0.6, 0.8]) * (across > 0)
        np.testing.assert_allclose(force[:2], rubbed, rtol=1e-4, atol=1e-9)
    # What matters is how they move against each other.
    moving = eqx.tree_at(lambda o: o.motion, floor, Motion(turn[:, 0], jnp.zeros(3)), is_leaf=lambda x: x is None)
    still = Motion(jnp.zeros(3), jnp.zeros(3))
    np.testing.assert_allclose(
        world_wrench(scene(outline, moving), placed, still), push(-turn[:, 0]), rtol=1e-9, atol=1e-9
    )


@pytest.mark.slow
def test_what_is_let_go_is_lifted_by_a_platform_and_falls_as_it_drops_away(outline):
    top = ObstaclePath(
        np.array([0.0, 0.2, 0.6, 0.601]), np.array([[0, 0, z] for z in (0, 0, 0.1, -1.0)]), np.zeros((4, 3))
    )
    board = Obstacle(Box(0.3, 0.3, 0.02), Pose(jnp.array([0.0, 0, -0.036]), jnp.eye(3)), 2e3, path=top)
    record = simulate(scene(outline, board), without_hand(160), WORLD, DT)
    heights = np.array([instant.placed.origin[2] for instant in record])
    times = DT * np.arange(160)
    risen = (times > 0.25) & (times < 0.59)
    np.testing.assert_allclose(heights[risen], 0.25 * (times[risen] - 0.2), atol=2e-3)
    falls = times > 0.61
    thrown = 0.1 + 0.25 * (times[falls] - 0.6) - 9.81 / 2 * (times[falls] - 0.6) ** 2
    np.testing.assert_allclose(heights[falls], thrown, atol=6e-3)


@pytest.fixture(scope="module")
def bent():
    """Return a hand whose links are some millimetres below a level, the level, the posture and the contacts with it."""
    hand, level = human_hand(), Pose(jnp.array([0.0, 0.0, -0.0195]), jnp.eye(3))
    posture = Posture(WORLD, jnp.full(len(hand.joints), 0.15))
    return hand, level, posture, find_contacts(hand, posture, Plane(), level)


def by_work(hand, posture, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Compute the torques that resist forces at points of the links: less their work for a small turn of each joint."""
    links = pose_hand(hand, posture).links
    local = np.einsum("lji,lj->li", links.rotation, points - links.origin)
    turned = posture.angles + 1e-6 * jnp.concatenate([jnp.eye(len(hand.joints)), -jnp.eye(len(hand.joints))])
    wrists = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(turned), *x.shape)), posture.wrist)
    moved = pose_hand(hand, Posture(wrists, turned)).links
    moved_points = np.einsum("tlij,lj->tli", moved.rotation, local) + moved.origin
    forward, back = np.split(moved_points, 2)
    return -np.einsum("jli,li->j", forward - back, forces) / 2e-6


@pytest.mark.parametrize("what", ["table", "obstacle"])
def test_the_hand_is_stopped_by_springs_or_goes_through(outline, bent, what):
    """Torques by virtual work, of K depth down on each link that touches."""
    hand, level, posture, reaction = bent
    if what == "table":
        stops, lets = (scene(None, hand=hand, table_touches_hand=touches) for touches in (True, False))
        stops, lets = (eqx.tree_at(lambda s: s.table, table_height, level) for table_height in (stops, lets))
    else:
        walls = (Obstacle(Plane(), level, 9e9, touches_hand=touches) for touches in (True, False))
        stops, lets = (scene(outline, wall, hand=hand) for wall in walls)
    forces = np.outer(2e3 * reaction.depths * reaction.present, [0.0, 0.0, -1.0])
    expected = by_work(hand, posture, np.asarray(reaction.points), forces)
    assert np.abs(expected).max() > 0.1 and reaction.present.sum() > 4
    np.testing.assert_allclose(hand_torques(stops, posture), expected, atol=1e-6)
    assert not np.any(hand_torques(lets, posture))


@pytest.mark.slow
def test_a_wall_that_comes_is_felt_once_it_is_there(outline):
    """A jaw's finger at rest, its tick at any time: newtons of springs as deep as the wall has come, one a pad."""
    hand = parallel_jaw()
    posture = Posture(WORLD, jnp.asarray(hand.upper))
    frames, skin = pose_hand(hand, posture), hand.skin
    ahead = np.asarray(frames.axes[0])
    pads = [k for k, link in enumerate(hand.links) if link.joint == 0]
    link = pads[0]
    centers = np.asarray(frames.links.origin[link] + skin.centers[link] @ frames.links.rotation[link].T)
    reach = (centers @ ahead + np.asarray(skin.radii[link])).max()
    facing = Rotation.align_vectors([-ahead], [[0, 0, 1]])[0].as_matrix()
    comes = ObstaclePath(np.array([0.0, 1.0]), np.array([0 * ahead, -0.012 * ahead]), np.zeros((2, 3)))
    wall = Obstacle(Plane(), Pose(jnp.asarray((reach + 0.01) * ahead), jnp.asarray(facing)), 1e3, path=comes)
    far = Pose(jnp.array([0.0, 0.0, -0.4]), jnp.eye(3))
    observe_at = jax.jit(lambda time: observe(scene(outline, wall), posture, far, time=time))
    for time, newtons in ((0.0, 0.0), (0.8, 0.0), (0.9, 1.6), (1.0, 4.0), (7.0, 4.0)):
        tick = observe_at(time)
        assert float(tick.blocked[0]) == pytest.approx(-len(pads) * newtons, abs=1e-6)
        np.testing.assert_array_equal(tick.torques, tick.blocked)
