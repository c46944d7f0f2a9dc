"""A hand among many objects: what its joints feel against work and weights that are known otherwise."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip import Hold
from jaxgrasp.hand import Pose, Posture
from jaxgrasp.model.task import smooth_step
from jaxgrasp.world import simulate_world
from tests.world.worlds import BLOCK, ENGINES, G, pusher, world_with

RADIUS, DISTANCE, DT = 0.008, 0.05, 0.01
MASSES = np.array([0.3, 0.2])


def pushed(name: str) -> tuple:
    """Push a block that pushes another with a ball; return the world, the ball's displacements and the steps.

    The ball is frictionless: with friction, its share of the block's weight would be undetermined.
    """
    centers = np.array([[0, 0, 0.02], [BLOCK.length, 0, 0.02]])
    world, state = world_with([BLOCK, BLOCK], centers, MASSES.tolist(), hand=pusher(RADIUS), skin=0.01)
    times = np.arange(0, 0.8 + DT / 2, DT)
    ways = DISTANCE * np.asarray(smooth_step(jnp.asarray(times / 0.6)))
    wrist = np.array([-BLOCK.length / 2 - RADIUS, 0, 0.02])
    count = len(times)
    poses = Pose(jnp.broadcast_to(wrist, (count, 3)), jnp.broadcast_to(jnp.eye(3), (count, 3, 3)))
    record = simulate_world(
        world, ENGINES[name](world, state), Posture(poses, jnp.asarray(ways)[:, None]), state, DT, law="optimum"
    )
    return world, ways, record


@pytest.mark.slow
@pytest.mark.parametrize("name", ENGINES)
def test_the_joint_feels_the_friction_of_both_blocks(name):
    """Work of the rendered torque: friction's loss at the table, and what the finger's spring keeps."""
    _, ways, record = pushed(name)
    torques = np.array([np.asarray(instant.share.torques)[0] for instant in record])
    work = -float(torques[:-1] @ np.diff(ways))
    last = record[-1].state
    displacement = last.placed.origin[:, 0] - record[0].state.placed.origin[:, 0]
    loss = float(0.5 * G * MASSES @ displacement)
    left = float(np.max(record[-1].share.touches.contacts.depths)) ** 2 * 2000.0 / 2
    moving = float(MASSES @ (last.motion.linear**2).sum(1)) / 2
    assert displacement.min() > 0.9 * DISTANCE and moving < 1e-6
    assert work == pytest.approx(loss + left, rel=0.04)
    # On the way, in the mean: it feels both, and the first block exerts on the second what that one needs.
    instants = slice(15, 50)
    gained = np.mean([instant.gained[:, 0] for instant in record[instants]], 0)
    assert -torques[instants].mean() == pytest.approx(0.5 * G * MASSES.sum() + gained.sum(), rel=0.06)
    passed_on = np.mean([instant.loads.by_bodies[1, 0, 0] for instant in record[instants]])
    # Rubbing on each other they shift weight between them: friction is by what the table bears.
    borne = np.mean([instant.loads.by_table[1, 2] for instant in record[instants]])
    assert passed_on == pytest.approx(0.5 * borne + gained[1], rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("name", ENGINES)
def test_the_hands_share_is_what_the_motion_needs(name):
    """The hand's share follows from an object's change of momentum, weight and loads; untouched ones have none."""
    world, _, record = pushed(name)
    assert world.scene.hand.joints == ("way",)
    for instant, after in pairwise(record):
        momentum = MASSES[:, None] * (after.state.motion.linear - instant.state.motion.linear) / DT
        needed = momentum - MASSES[:, None] * [0, 0, -G] - instant.loads.by_world[:, :3]
        exerted = np.asarray(instant.share.exerted)
        hold = np.asarray(instant.share.assessment.hold)
        np.testing.assert_allclose(np.asarray(instant.share.wrench)[:, :3], needed, atol=1e-9)
        np.testing.assert_allclose(exerted[1], 0, atol=0)
        assert hold[1] == Hold.LOST
        if hold[0] == Hold.STABLE:
            np.testing.assert_allclose(exerted[0].sum(0), needed[0], atol=1e-5)
        elif hold[0] == Hold.SLIPPING:
            np.testing.assert_allclose(
                exerted[0].sum(0) + np.asarray(instant.share.wrench_residual)[0, :3], needed[0], atol=1e-5
            )
    # What the engine has the hand exert is that too, but for what moves while a step of many is averaged.
    needed, engine = (
        np.array([np.asarray(part)[0] for part in parts])
        for parts in zip(*((instant.share.wrench, instant.loads.by_hand) for instant in record))
    )
    np.testing.assert_allclose(engine[:, :3], needed[:, :3], atol=1e-4)


def test_bad_steps_are_refused():
    world, state = world_with([BLOCK], np.array([[0, 0, 0.02]]), [0.2], hand=pusher())
    engine = ENGINES["quasi-static"](world, state)
    posture = Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.zeros(1))
    with pytest.raises(ValueError, match="dt is 0.0: expected a positive time"):
        simulate_world(world, engine, posture, state, 0.0)
    with pytest.raises(ValueError, match=r"postures.angles has shape \(1,\): expected \(T, J\), T instants"):
        simulate_world(world, engine, posture, state, 0.1)
    assert jax.tree.all(jax.tree.map(lambda x: np.all(np.isfinite(x)), state))
