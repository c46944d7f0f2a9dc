"""Rigid motions: inverses, fits, supports and moments of inertia, each by another way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip.motion import Body, Motion, follow, motion_between, moved, spatial_inertia
from jaxgrasp.grip.simulation import integrate_spin
from jaxgrasp.hand import Box, Capsule, Cylinder, Pose, Posture, Sphere, human_hand, pose_hand, signed_distance
from jaxgrasp.numerics.vec3 import Vec3
from tests.hand.hands import random_posture, rotations

SOLIDS = [Sphere(0.04), Box(0.05, 0.08, 0.03), Cylinder(0.03, 0.1), Capsule(0.02, 0.06)]
each_solid = pytest.mark.parametrize("shape", SOLIDS, ids=[type(shape).__name__ for shape in SOLIDS])
RNG = np.random.default_rng(2)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 3.0])
def test_a_motion_leads_where_it_was_read_from(angle):
    axis = np.array([0.48, -0.6, 0.64])
    start = Pose(RNG.normal(size=3), rotations(1, RNG)[0])
    motion = Motion(jnp.asarray(RNG.normal(size=3)), jnp.asarray(angle / 0.1 * axis))
    again = motion_between(start, moved(start, motion, 0.1), 0.1)
    np.testing.assert_allclose(again.linear, motion.linear, atol=1e-13)
    np.testing.assert_allclose(again.angular, motion.angular, atol=1e-13)
    turned = moved(start, motion, 0.1).rotation
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("touching", [1, 2, 3, 12])
def test_what_a_rigid_hand_holds_goes_with_it(touching):
    hand = human_hand()
    posture = jax.tree.map(lambda x: x[0], random_posture(hand, 1))
    turn, shift = rotations(1, RNG)[0], RNG.normal(size=3)
    later = Posture(Pose(turn @ posture.wrist.origin + shift, turn @ posture.wrist.rotation), posture.angles)
    before, after = pose_hand(hand, posture), pose_hand(hand, later)
    weights = np.where(np.arange(19) < touching, RNG.uniform(0.1, 1, 19), 0.0)
    points = np.asarray(before.links.origin) + RNG.normal(scale=0.02, size=(19, 3))
    start = Pose(RNG.normal(size=3), rotations(1, RNG)[0])
    went = follow(before, after, points, weights, start)
    np.testing.assert_allclose(went.origin, turn @ start.origin + shift, atol=1e-12)
    np.testing.assert_allclose(went.rotation, turn @ start.rotation, atol=1e-12)


@each_solid
def test_support_and_moments_are_those_of_the_solid(shape):
    """Against points drawn at random inside: a support by the furthest, moments by the mean."""
    cloud = np.random.default_rng(1).uniform(-0.06, 0.06, (400_000, 3))
    inside = cloud[np.asarray(signed_distance(shape, cloud)[0]) < 0]
    for direction in rotations(3, RNG)[:, 0]:
        furthest = (inside @ direction).max()
        reach = float(shape._support(Vec3(*jnp.asarray(direction))))
        assert furthest <= reach < furthest + 2.5e-3
    squares = (inside**2).mean(0)
    expected = squares.sum() - squares
    np.testing.assert_allclose([float(m) for m in shape._moments()], expected, rtol=0.02)
    turn = rotations(1, RNG)[0]
    inertia = spatial_inertia(Body(shape, 2.0), turn)
    about = inside @ turn.T
    second = 2.0 * np.einsum("pi,pj->ij", about, about) / len(inside)
    np.testing.assert_allclose(inertia[3:, 3:], np.trace(second) * np.eye(3) - second, atol=0.03 * expected.max())
    np.testing.assert_allclose(inertia[:3, :3], 2.0 * np.eye(3), atol=1e-15)


def test_a_body_of_any_inertia_keeps_its_momentum_and_gains_no_energy():
    """Free for a quarter of a second, of a solid whose axes are not its principal ones; errors are as long as steps."""
    arms = np.random.default_rng(3).normal(scale=0.05, size=(5, 3))
    arms -= arms.mean(0)
    second = 0.1 * arms.T @ arms
    body = Body(Sphere(0.1), 0.5, np.trace(second) * np.eye(3) - second)
    spin = np.array([3.0, -2.0, 4.0])

    @jax.jit
    def spun_for(step: float, count: int) -> tuple:
        def go(_, state: tuple) -> tuple:
            turn, momentum = state
            after = integrate_spin(body, turn, momentum, step)
            return moved(Pose(jnp.zeros(3), turn), Motion(jnp.zeros(3), after), step).rotation, after

        turn, after = jax.lax.fori_loop(0, count, go, (jnp.eye(3), jnp.asarray(spin)))
        inertia = spatial_inertia(body, turn)[3:, 3:]
        return turn, inertia @ after, after @ inertia @ after

    inertia = np.asarray(body.inertia_matrix())
    momentum, energy = inertia @ spin, spin @ inertia @ spin
    misses, losses = [], []
    for step, count in ((2e-4, 1250), (1e-4, 2500)):
        turn, last_momentum, left = jax.device_get(spun_for(step, count))
        assert np.abs(turn - np.eye(3)).max() > 0.5 and left <= energy * (1 + 1e-12)
        misses.append(np.linalg.norm(last_momentum - momentum) / np.linalg.norm(momentum))
        losses.append(1 - left / energy)
    assert misses[1] < 2e-3 and misses[1] == pytest.approx(misses[0] / 2, rel=0.05)
    assert losses[1] < 2e-3 and losses[1] == pytest.approx(losses[0] / 2, rel=0.05)
