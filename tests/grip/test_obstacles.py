"""Obstacles: springs to a hand that presses an object into them, and rigid to an object on its own."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Body, Hold, Obstacle, Scene, observe, simulate
from jaxgrasp.grip.motion import spatial_inertia
from jaxgrasp.grip.simulation import integrate_spin
from jaxgrasp.hand import (
    Box,
    Plane,
    Pose,
    Posture,
    Sphere,
    close_hand,
    parallel_jaw,
    rigid_body,
    sphere_tree,
    world_contacts,
)
from jaxgrasp.numerics.small_minimisers import minimise_nonnegative
from tests.grip.hands import without_hand

SHAPE, MASS, DT = Box(0.06, 0.08, 0.05), 0.5, 5e-3
GRAVITY = np.array([0.0, 0.0, -9.81])
BODY = Body(SHAPE, MASS)
RNG = np.random.default_rng(4)


@pytest.fixture(scope="module")
def outline():
    return rigid_body(sphere_tree(SHAPE, 4))


def scene(outline, *obstacles: Obstacle, floor: float = -0.3, **more) -> Scene:
    hand = parallel_jaw()
    table = Pose(jnp.array([0.0, 0.0, floor]), jnp.eye(3))
    links = jnp.ones(len(hand.links))
    gravity = jnp.asarray(GRAVITY)
    return Scene(hand, BODY, table, 0.5, 2000.0, links, gravity, obstacles=obstacles, outline=outline, **more)


def turned(*degrees: float) -> np.ndarray:
    return Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()


def energies(record: list) -> np.ndarray:
    """Compute the kinetic energy between two instants, and the gravitational energy left after it."""
    origin = np.array([instant.placed.origin for instant in record])
    rotation = np.array([instant.placed.rotation for instant in record])
    linear = np.diff(origin, axis=0) / DT
    angular = Rotation.from_matrix(rotation[1:] @ rotation[:-1].swapaxes(1, 2)).as_rotvec() / DT
    motion = np.concatenate([linear, angular], -1)
    inertia = np.array([spatial_inertia(BODY, r) for r in rotation[:-1]])
    return np.einsum("ti,tij,tj->t", motion, inertia, motion) / 2 - MASS * origin[1:] @ GRAVITY


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.0, 25.0, 60.0])
def test_what_falls_on_obstacles_gains_no_energy_and_goes_no_deeper(outline, slope):
    ramp = Obstacle(Box(0.3, 0.3, 0.02), Pose(jnp.array([0.0, 0, -0.05]), jnp.asarray(turned(0, slope, 0))), 2e3)
    post = Obstacle(Sphere(0.05), Pose(jnp.array([0.2, 0.02, -0.16]), jnp.eye(3)), 2e3)
    start = Pose(jnp.array([0.0, 0.01, 0.06]), jnp.asarray(turned(20, 10, 5)))
    record = simulate(scene(outline, ramp, post), without_hand(150), start, DT)
    assert {instant.hold for instant in record} == {Hold.LOST}
    energy = energies(record)
    scale = MASS * 9.81 * 0.36
    assert np.diff(energy).max() <= 1e-12 * scale and energy[-1] < energy[0] - 0.1 * scale
    depths = [
        float(world_contacts(outline, instant.placed, o.shape, o.placed).depths.max())
        for instant in record
        for o in (ramp, post)
    ]
    assert 0 < max(depths) < 1.5e-3
    assert any(instant.stands for instant in record)
    last = float(record[-1].placed.origin[2])
    # On a level board it comes to rest; down a slope it slides off, and the table has it.
    assert last == pytest.approx(-0.04 + 0.025, abs=0.012) if slope == 0 else last < -0.2


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.025, 0.03, 0.034, 0.4])
def test_a_thin_board_stops_it_too(outline, start):
    """From whatever height, and so at whatever place of a step it comes to the board."""
    board = Obstacle(Box(0.3, 0.3, 0.002), Pose(jnp.array([0.0, 0, -0.1]), jnp.eye(3)), 2e3)
    record = simulate(scene(outline, board), without_hand(90), Pose(jnp.array([0.0, 0.0, start]), jnp.eye(3)), DT)
    assert float(record[-1].placed.origin[2]) == pytest.approx(-0.099 + 0.025, abs=1.5e-3) and record[-1].stands


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "depth", "spring", "push", "largest"),
    [(2000.0, 1e-3, 400.0, 2e-3, 2.0), (8000.0, 1e-2, 4000.0, 5.2e-3, 66.0)],
)
def test_a_hand_that_presses_it_down_is_pressed_back(outline, stiffness, depth, spring, push, largest):
    """Eq. 1: the hand exerts the weight less what the springs carry; and the object yields in the hand, as the springs
    of both say (eq. 6): under a few newtons as under 66 N, where the squeeze bears them."""
    hand = parallel_jaw()
    opened = Posture(Pose(jnp.zeros(3), jnp.asarray(turned(180, 0, 90))), jnp.asarray(hand.lower))
    placed = Pose(jnp.array([0.0, 0.0, -0.11]), jnp.eye(3))
    closed, contacts = close_hand(hand, opened, SHAPE, placed, depth)
    assert contacts.present.sum() >= 4
    count, bottom = 24, -0.11 - 0.025
    board = Obstacle(Plane(), Pose(jnp.array([0.0, 0.0, bottom]), jnp.eye(3)), spring)
    down = np.minimum(np.linspace(0, 2 * push, count), push)
    origin = np.stack([0 * down, 0 * down, -down], -1)
    rotation = np.broadcast_to(np.asarray(opened.wrist.rotation), (count, 3, 3))
    postures = Posture(Pose(origin, rotation), np.broadcast_to(np.asarray(closed.angles), (count, 2)))
    stiff = eqx.tree_at(lambda scene: scene.stiffness, scene(outline, board, floor=-5.0), stiffness)
    record = simulate(stiff, postures, placed, DT, law="optimum")
    assert {instant.hold for instant in record} == {Hold.STABLE}
    depths = np.array([-0.11 - float(instant.placed.origin[2]) for instant in record])
    for k in range(3, count - 1):
        # The springs push by their depth at the end of a step.
        carried = 4 * spring * depths[k + 1]
        gained = -(depths[k + 1] - 2 * depths[k] + depths[k - 1]) / DT**2
        held = MASS * (9.81 + gained) - carried
        assert np.asarray(record[k].exerted).sum(0)[2] == pytest.approx(held, abs=1e-6)
        assert float(record[k].tick.wrench[2]) == pytest.approx(held, abs=1e-6)
    in_all = float(record[-1].tick.stiffness.sum())
    assert 4 * spring * depths[-1] > largest
    assert down[-1] - depths[-1] == pytest.approx(4 * spring * depths[-1] / in_all, rel=0.1)


@pytest.mark.slow
def test_on_a_rail_a_stop_holds_it(outline):
    """Fig. 8's bar: what is let go comes down along its rail, and stays on the bar."""
    bar = Obstacle(Box(0.15, 0.02, 0.02), Pose(jnp.array([0.0, 0, -0.05]), jnp.eye(3)), 2e3)
    start = Pose(jnp.array([0.005, 0.0, 0.02]), jnp.eye(3))
    record = simulate(scene(outline, bar, guide=np.eye(6)[:, 2:3]), without_hand(60), start, DT)
    places = np.array([instant.placed.origin for instant in record])
    np.testing.assert_array_equal(places[:, :2], [[0.005, 0]] * 60)
    assert places[-1, 2] == pytest.approx(-0.04 + 0.025, abs=1e-3) and record[-1].stands
    assert np.abs(np.diff(places[-10:, 2])).max() < 1e-6


def test_a_spin_in_the_air_loses_energy_but_hardly():
    """An implicit step of Euler's equations; momentum stays but for the same error."""
    turn, spin = turned(10, 20, 30), np.array([3.0, -2.0, 5.0])
    inertia = np.asarray(spatial_inertia(BODY, turn))[3:, 3:]
    after = np.asarray(integrate_spin(BODY, turn, spin, 1e-3))
    energy, energy_after = spin @ inertia @ spin, after @ inertia @ after
    assert energy * (1 - 1e-4) < energy_after <= energy
    np.testing.assert_allclose(inertia @ (after - spin), -1e-3 * np.cross(spin, inertia @ spin), rtol=0.02)


def test_impulses_are_the_least_squares_of_zero_or_more():
    for size, rank in ((3, 3), (8, 6), (12, 6)):
        root, target = RNG.normal(size=(rank, size)), RNG.normal(size=rank)
        impulses = np.asarray(minimise_nonnegative(jnp.asarray(root.T @ root), jnp.asarray(-root.T @ target)))
        assert (impulses >= 0).all()
        assert np.linalg.norm(root @ impulses - target) == pytest.approx(nnls(root, target)[1], abs=1e-6)
    idle = np.zeros((2, 2))
    idle[0, 0] = 2.0
    np.testing.assert_allclose(minimise_nonnegative(jnp.asarray(idle), jnp.array([-4.0, -1.0])), [2, 0])


@pytest.mark.slow
def test_a_compiled_tick_feels_the_world(outline):
    """Rails and obstacles are arguments like any others."""
    ground = Obstacle(Plane(), Pose(jnp.zeros(3), jnp.eye(3)), 1e3)
    world = scene(outline, ground, guide=jnp.eye(6)[:, 2:3])
    posture = Posture(Pose(jnp.full(3, 9.0), jnp.eye(3)), jnp.zeros(2))
    placed = Pose(jnp.array([0, 0, 0.02]), jnp.eye(3))
    plain, compiled = observe(world, posture, placed), jax.jit(observe)(world, posture, placed)
    np.testing.assert_allclose(compiled.wrench, plain.wrench, rtol=1e-12)
    assert float(plain.wrench[2]) < MASS * 9.81


def test_obstacles_need_an_outline(outline, unchecked):
    ground = Obstacle(Plane(), Pose(np.zeros(3), np.eye(3)), 1e3)
    worlds = (
        scene(None, ground),
        scene(sphere_tree(SHAPE, 2), ground),
        Scene(**{**vars(scene(outline)), "obstacles": ground}),
    )
    messages = (
        "outline is None: expected rigid_body.sphere_tree.shape.. of the object",
        "outline is a SphereTree",
        "obstacles is a Obstacle",
    )
    for world, words in zip(worlds, messages, strict=True):
        with pytest.raises(ValueError, match=words):
            simulate(world, without_hand(2), Pose(np.zeros(3), np.eye(3)), DT)
