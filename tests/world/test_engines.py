"""Both engines against balances of their own steps: weights, falls, slopes, overhangs, and Newton's laws."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.hand import Box, Cylinder, Sphere
from jaxgrasp.world import QuasiStaticEngine, WorldState, quasi_static
from tests.world.worlds import BLOCK, ENGINES, G, left_alone, some_turn, tower, world_with

EACH_ENGINE = pytest.mark.parametrize("name", ENGINES)
WEIGHT_ERROR = {"quasi-static": 1e-6, "mujoco": 1e-4}
"""Of the whole weight, at rest."""


def of_world(name, world, state, seconds, dt=0.01):
    return left_alone(world, ENGINES[name](world, state), state, seconds, dt)


@pytest.mark.slow
@EACH_ENGINE
def test_a_stack_at_rest_carries_what_is_above(name):
    masses = [0.3, 0.2, 0.5]
    world, state = tower(masses, 0.2)
    last = of_world(name, world, state, 0.5)[-1]
    error = WEIGHT_ERROR[name] * G * sum(masses)
    np.testing.assert_allclose(last.loads.by_table[0, :3], [0, 0, G * sum(masses)], atol=error)
    np.testing.assert_allclose(last.loads.by_bodies[1, 0, :3], [0, 0, G * 0.7], atol=error)
    np.testing.assert_allclose(last.loads.by_bodies[2, 1, :3], [0, 0, G * 0.5], atol=error)
    assert last.solved and np.abs(last.state.placed.origin - state.placed.origin).max() < 2e-4


@pytest.mark.slow
@EACH_ENGINE
@pytest.mark.parametrize("overhang", [0.2, 0.45, 0.55, 0.8])
def test_a_block_that_stands_out_beyond_half_falls(name, overhang):
    world, state = tower([0.3, 0.2], overhang)
    last = of_world(name, world, state, 0.4)[-1]
    fallen = state.placed.origin[1, 2] - last.state.placed.origin[1, 2]
    assert fallen > 5e-3 if overhang > 0.5 else fallen < 1e-4


@pytest.mark.slow
@EACH_ENGINE
@pytest.mark.parametrize("rubbing", [0.45, 0.55])
def test_a_block_slides_where_the_slope_exceeds_the_friction(name, rubbing):
    """And gains speed by what is left of gravity."""
    slope = np.arctan(0.5)
    gravity = (G * np.sin(slope), 0.0, -G * np.cos(slope))
    world, state = world_with([BLOCK], np.array([[0, 0, 0.02]]), [0.2], rubbing=rubbing, gravity=gravity)
    speed = of_world(name, world, state, 0.4)[-1].state.motion.linear[0, 0]
    expected = max(0.0, 0.4 * G * (np.sin(slope) - rubbing * np.cos(slope)))
    assert speed == pytest.approx(expected, rel=0.03, abs=1e-3)


@pytest.mark.slow
def test_a_sliding_block_stays_on_the_table_and_stops_where_friction_has_taken_its_energy():
    world, state = world_with([BLOCK], np.array([[0, 0, 0.02]]), [0.2])
    state.motion.linear[0] = [1.0, 0.0, 0.0]
    steps = of_world("quasi-static", world, state, 0.4)
    placed = np.stack([step.state.placed.origin[0] for step in steps])
    np.testing.assert_allclose(placed[:, 2], 0.02, atol=1e-6)
    friction = np.array([step.loads.by_table[0, 0] for step in steps])
    work = -float(friction @ np.diff(placed[:, 0], prepend=0.0))
    assert work == pytest.approx(0.5 * 0.2 * G * placed[-1, 0], rel=0.02)
    # A step in time takes a last half step of friction too early.
    assert placed[-1, 0] == pytest.approx(1.0 / (2 * 0.5 * G), rel=0.06)
    assert np.abs(steps[-1].state.motion.linear).max() < 1e-4


@pytest.mark.slow
def test_objects_that_fall_on_one_another_lose_energy_and_come_to_rest():
    """At up to 3 cm in a step: every corner has its own gap, so that none ends inside another object."""
    shapes, masses = [BLOCK, Box(0.05, 0.05, 0.05), BLOCK], np.array([0.2, 0.2, 0.2])
    centers = np.array([[0, 0, 0.1], [0.01, -0.01, 0.3], [-0.015, 0.01, 0.5]])
    world, state = world_with(shapes, centers, masses.tolist(), turns=np.stack([some_turn(k) for k in range(3)]))
    steps = of_world("quasi-static", world, state, 1.5)
    halves = [np.array([shape.length, shape.width, shape.height]) / 2 for shape in shapes]
    inertia = np.stack([m / 3 * (half @ half - half**2) for m, half in zip(masses, halves, strict=True)])

    def energy(state: WorldState) -> float:
        spin = np.einsum("nij,ni->nj", state.placed.rotation, state.motion.angular)
        moving = (masses @ (state.motion.linear**2).sum(1) + (inertia * spin**2).sum()) / 2
        return float(moving + G * masses @ state.placed.origin[:, 2])

    energies = np.array([energy(state), *(energy(step.state) for step in steps)])
    assert np.diff(energies).max() < 1e-5 * (energies[0] - energies[-1])
    assert np.abs(steps[-1].state.motion.linear).max() < 1e-4
    for step in steps:
        placed = step.state.placed
        lowest = placed.origin[:, 2] - [np.abs(r[2]) @ h for r, h in zip(placed.rotation, halves, strict=True)]
        assert lowest.min() > -1e-4


@pytest.mark.slow
def test_a_plate_that_tumbles_keeps_its_angular_momentum_and_gains_no_energy():
    turn = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    world, state = world_with([Box(0.1, 0.08, 0.002)], np.array([[0, 0, 2.0]]), [0.05], turns=turn[None])
    state.motion.angular[0] = [10.0, 6.0, 3.0]
    inertia = 0.05 / 12 * np.array([0.08**2 + 0.002**2, 0.1**2 + 0.002**2, 0.1**2 + 0.08**2])
    energies = []
    for step in of_world("quasi-static", world, state, 0.3):
        spin = step.state.placed.rotation[0].T @ step.state.motion.angular[0]
        energies.append(spin @ (inertia * spin) / 2)
        np.testing.assert_allclose(step.gained[0, 3:], 0, atol=1e-9)
    assert np.diff(energies).max() <= 0 and energies[-1] > 0.9 * energies[0]


@pytest.mark.slow
def test_a_light_block_rests_on_a_heavy_one():
    world, state = tower([1.0, 0.001])
    last = of_world("quasi-static", world, state, 1.0)[-1]
    assert last.solved and np.abs(last.state.placed.origin - state.placed.origin).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0, 35])
def test_a_disc_on_its_face_or_its_rim_stays_on_the_table(tilt):
    """It rolls around its rim, whose lowest point moves on by a third of a radian in a step."""
    disc, turn = Cylinder(0.04, 0.004), Rotation.from_euler("y", tilt, degrees=True).as_matrix()
    height = 0.002 * turn[2, 2] + 0.04 * np.sqrt(1 - turn[2, 2] ** 2)
    world, state = world_with([disc], np.array([[0, 0, height]]), [0.2], turns=turn[None])
    state.motion.angular[0] = [-15.0, -20.0, 2.0] if tilt else 0.0
    for step in of_world("quasi-static", world, state, 0.6):
        up = step.state.placed.rotation[0, 2, 2]
        lowest = step.state.placed.origin[0, 2] - 0.002 * abs(up) - 0.04 * np.sqrt(max(0.0, 1 - up**2))
        assert lowest > (-1e-3 if tilt else -1e-8)


@pytest.mark.slow
@EACH_ENGINE
def test_what_is_released_falls_and_keeps_its_spin(name):
    world, state = world_with([Sphere(0.02), Box(0.05, 0.03, 0.02)], np.array([[0, 0, 2.0], [1, 0, 3.0]]), [0.1, 0.2])
    state.motion.angular[1] = [1.0, 2.0, 3.0]
    steps = of_world(name, world, state, 0.3)
    engine_step = 0.01 if name == "quasi-static" else 0.001
    fallen = state.placed.origin[:, 2] - steps[-1].state.placed.origin[:, 2]
    # An engine that gives gravity's speed at once is half a step ahead.
    np.testing.assert_allclose(fallen, G * 0.3 * (0.3 + engine_step) / 2, rtol=1e-9)
    gained = np.stack([step.gained for step in steps])
    np.testing.assert_allclose(gained[..., :3].mean(0), [[0, 0, -G * 0.1], [0, 0, -G * 0.2]], atol=1e-9)
    np.testing.assert_allclose(gained[:, 1, 3:], 0, atol=2e-5)


@pytest.mark.slow
@EACH_ENGINE
def test_motion_is_what_the_loads_make_of_it(name):
    """In a falling tower, mass times acceleration is weight and loads, and the loads between two bodies are opposite,
    with moments about one point."""
    masses = np.array([0.3, 0.2])
    world, state = tower(masses.tolist(), 0.7)
    steps = of_world(name, world, state, 0.3)
    before = state
    for step in steps:
        momentum = masses[:, None] * (step.state.motion.linear - before.motion.linear) / 0.01
        weight = masses[:, None] * [0, 0, -G]
        np.testing.assert_allclose(momentum, weight + step.loads.by_world[:, :3] + step.loads.by_hand[:, :3], atol=1e-6)
        load, reaction = step.loads.by_bodies[0, 1], step.loads.by_bodies[1, 0]
        np.testing.assert_allclose(load[:3], -reaction[:3], atol=1e-12)
        arm = before.placed.origin[1] - before.placed.origin[0]
        about_first = reaction[3:] + np.cross(arm, reaction[:3])
        # The centres move on while a step of many is averaged.
        moved = np.abs(step.state.placed.origin - before.placed.origin).max() * np.linalg.norm(reaction[:3])
        np.testing.assert_allclose(load[3:], -about_first, atol=2 * moved + 1e-9)
        before = step.state


@pytest.mark.slow
@EACH_ENGINE
def test_turning_the_world_turns_what_happens(name):
    turn = some_turn(5)
    ends = []
    for frame in (np.eye(3), turn):
        world, state = tower([0.3, 0.2], 0.2, frame=frame)
        last = of_world(name, world, state, 0.2)[-1]
        ends.append((last.state.placed.origin @ frame, last.loads.by_table[:, :3] @ frame))
    (end_state, loads), (turned_state, turned) = ends
    np.testing.assert_allclose(turned_state, end_state, atol=1e-6)
    np.testing.assert_allclose(turned, loads, atol=1e-4)


@pytest.mark.slow
@EACH_ENGINE
def test_the_order_of_the_objects_does_not_matter(name):
    shapes, centers = [BLOCK, Sphere(0.02)], np.array([[0, 0, 0.02], [0.1, 0, 0.05]])
    ends = []
    for order in ([0, 1], [1, 0]):
        world, state = world_with([shapes[k] for k in order], centers[order], [[0.3, 0.1][k] for k in order])
        last = of_world(name, world, state, 0.2)[-1]
        by_object = (last.state.placed, last.state.motion, last.loads.by_table)
        ends.append(jax.tree.map(lambda part, order=order: part[np.argsort(order)], by_object))
    jax.tree.map(lambda actual, expected: np.testing.assert_allclose(actual, expected, atol=1e-5), *ends)


@pytest.mark.slow
def test_after_the_warm_up_no_step_compiles():
    world, state = tower([0.3, 0.2], 0.7)
    engine = QuasiStaticEngine(world, state)
    engine.warm_up()
    programs = quasi_static._program()._cache_size()
    left_alone(world, engine, state, 0.3, 0.01)
    assert programs > 0 and quasi_static._program()._cache_size() == programs
