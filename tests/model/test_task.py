"""Laws of tasks: what leads an object along a path exerts what its momentum and its weight ask for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Held, HeldCylinder, Lift, Shake, Task, Turn, carrying
from jaxgrasp.hand import Pose

TIMES = (0.0, 0.3, 0.77, 1.9)
GRAVITY = np.array([0.4, -2.0, -9.0])


def held(seed: int = 0) -> Held:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(4, 3))
    square = rng.normal(size=(3, 3))
    return Held(
        points=rng.normal(size=(4, 3)),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        friction=rng.uniform(0.3, 1, 4),
        contributions=rng.uniform(0.5, 2, 4),
        stiffness=800.0,
        depths=rng.uniform(1e-3, 3e-3, 4),
        mass=1.3,
        center_of_mass=rng.normal(size=3),
        inertia=square @ square.T,
    )


class Tumble(eqx.Module):
    """A path that turns and moves every way at once."""

    rates: jax.Array

    def __call__(self, time):
        angles = self.rates * jnp.sin(time * jnp.array([1.0, 1.7, 0.6]))
        turn = jnp.eye(3)
        for k, angle in enumerate(angles):
            turn = turn @ Turn(jnp.eye(3)[k], 1.0)(angle).rotation
        return Pose(jnp.cos(time * jnp.array([1.1, 0.3, 2.0])), turn)


def wrench_in_the_world(task: Task, path, time: float) -> np.ndarray:
    """Return force, and torque about the world's origin."""
    placed, (_, wrench) = path(time), task(time)
    force, torque = np.asarray(placed.rotation @ wrench[:3]), np.asarray(placed.rotation @ wrench[3:])
    return np.concatenate([force, torque + np.cross(placed.origin, force)])


def momentum(body: Held, path, time: float) -> np.ndarray:
    """Compute the linear momentum and the angular one about the world's origin, by differences of the pose alone."""
    h = 1e-4
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    rate = lambda f: sum(c * (f(time + k * h) - f(time - k * h)) / h for k, c in weights.items())  # noqa: E731
    center = lambda t: np.asarray(path(t).origin + path(t).rotation @ body.center_of_mass)  # noqa: E731
    turn, linear = np.asarray(path(time).rotation), body.mass * rate(center)
    spin_matrix = rate(lambda t: np.asarray(path(t).rotation)) @ turn.T
    spin = np.array([spin_matrix[2, 1], spin_matrix[0, 2], spin_matrix[1, 0]])
    return np.concatenate([linear, np.cross(center(time), linear) + turn @ body.inertia @ turn.T @ spin])


@pytest.mark.parametrize("time", TIMES)
def test_the_wrench_is_the_rate_of_the_momentum_less_gravity(time):
    body, path = held(), Tumble(jnp.array([0.7, -1.2, 0.4]))
    h, weights = 1e-3, {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    rate = sum(
        c * (momentum(body, path, time + k * h) - momentum(body, path, time - k * h)) / h for k, c in weights.items()
    )
    center = path(time).origin + path(time).rotation @ body.center_of_mass
    weight = np.concatenate([body.mass * GRAVITY, np.cross(center, body.mass * GRAVITY)])
    task = carrying(body, path, GRAVITY)
    np.testing.assert_allclose(wrench_in_the_world(task, path, time), rate - weight, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("time", TIMES)
def test_a_steady_turn_turns_the_weight_alone(time):
    cylinder = HeldCylinder(0.05, 0.2, jnp.array([0.0, 2.0, 4.0]), jnp.zeros(3), 0.5, 1.0, 1e3, 1e-3, 2.0, jnp.zeros(3))
    grasp, wrench = carrying(cylinder, Turn(np.array((0.0, 0.0, 3.0)), np.pi), np.array([0.0, -10.0, 0.0]))(time)
    angle = np.pi * time
    np.testing.assert_allclose(wrench[:3], [20 * np.sin(angle), 20 * np.cos(angle), 0], atol=1e-12)
    np.testing.assert_allclose(wrench[3:], 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(grasp.points[:, :2], axis=1), 0.05)
    np.testing.assert_allclose(grasp.squeeze, 1.0)


def test_a_turn_that_reverses_comes_back():
    turn, back = Turn(np.array((0.0, 0.0, 1.0)), np.pi, 2.0), Turn(np.array((0.0, 0.0, 1.0)), -np.pi)
    np.testing.assert_allclose(turn(1.3).rotation, Rotation.from_rotvec([0, 0, 1.3 * np.pi]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(turn(2.7).rotation, back(2.7).rotation, atol=1e-12)
    np.testing.assert_allclose(turn(4.0).rotation, np.eye(3), atol=1e-12)


def test_lifting_and_shaking_by_hand():
    body = held()
    lift = carrying(body, Lift(np.array((0.0, 0.0, 2.0)), 0.3, 2.0), np.array([0.0, 0.0, -9.81]))
    for time, extra in ((-1.0, 0), (0.0, 0), (1.0, 0), (2.0, 0), (5.0, 0), (0.5, 0.3 * 5.625 / 4)):
        np.testing.assert_allclose(lift(time)[1][2], body.mass * (9.81 + extra), atol=1e-9)
    shake = carrying(body, Shake(np.array((1.0, 0.0, 0.0)), 0.02, 3.0), np.zeros(3))
    for time in TIMES:
        expected = -body.mass * 0.02 * (6 * np.pi) ** 2 * np.sin(6 * np.pi * time)
        np.testing.assert_allclose(shake(time)[1][:3], [expected, 0, 0], atol=1e-10)


def test_a_cylinder_has_a_cylinders_inertia():
    cylinder = HeldCylinder(0.05, 0.2, jnp.zeros(1), jnp.zeros(1), 0.5, 1.0, 1e3, 1e-3, 2.0, jnp.zeros(3))
    rng = np.random.default_rng(1)
    radius, angle, height = 0.05 * np.sqrt(rng.random(400_000)), rng.random(400_000), 0.2 * rng.random(400_000) - 0.1
    cloud = np.stack([radius * np.cos(2 * np.pi * angle), radius * np.sin(2 * np.pi * angle), height], -1)
    expected = 2.0 * (np.mean(np.sum(cloud**2, 1)) * np.eye(3) - cloud.T @ cloud / len(cloud))
    np.testing.assert_allclose(cylinder.moments(), expected, atol=2e-5)


def test_a_task_of_ones_own_is_a_plain_function():
    body = held()
    task = Task({"mass": 2.0}, lambda p, time: (body.grasp(), p["mass"] * jnp.array([0.0, 0, time, 0, 0, 0])))
    np.testing.assert_allclose(task(3.0)[1], [0, 0, 6, 0, 0, 0])


def test_whole_numbers_are_taken_as_numbers(unchecked):
    turn = Turn(np.array([0.0, 0, 1]), 2.0)
    held = Held(
        np.array([[1, 0, 0], [-1, 0, 0]]),
        np.array([[-1, 0, 0], [1, 0, 0]]),
        0.5,
        1.0,
        1000.0,
        2.5e-3,
        1.0,
        np.zeros(3),
        np.eye(3),
    )
    grasp, wrench = carrying(held, turn)(1)
    np.testing.assert_allclose(grasp.friction, [0.5, 0.5])
    np.testing.assert_allclose(grasp.squeeze, [2.5, 2.5])
    np.testing.assert_allclose(wrench, carrying(held, turn)(1.0)[1])
