"""A hand's torques as limits of its grips: what the joints feel, by virtual work, stays below them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Verdict
from jaxgrasp.grip import power_grip
from jaxgrasp.hand import Cylinder, Hand, Posture, grasp_from_contacts, human_hand, mirrored, pose_hand, torque_limits

STEP = 1e-6


def torques_by_virtual_work(hand: Hand, posture: Posture, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Compute the work of the forces as each joint turns a little, each point carried by its link, over the angle."""
    frames = jax.device_get(pose_hand(hand, posture).links)
    local = np.einsum("lji,lj->li", frames.rotation, points - frames.origin)
    angles = np.asarray(posture.angles) + STEP * np.stack([np.eye(len(hand.joints)), -np.eye(len(hand.joints))])
    moved = jax.device_get(pose_hand(hand, Posture(posture.wrist, angles)).links)
    moved_points = moved.origin + np.einsum("sjlab,lb->sjla", moved.rotation, local)
    return np.einsum("jla,la->j", moved_points[0] - moved_points[1], forces) / (2 * STEP)


@pytest.fixture(scope="module")
def held():
    """Return a hand that holds a cylinder of 200 g: hand, posture, contacts, grasp and wrench."""
    hand = human_hand()
    posture, placed, contacts = power_grip(hand, Cylinder(0.03, 0.12))
    grasp = grasp_from_contacts(contacts, friction=0.6, stiffness=1000.0)
    wrench = jaxgrasp.weight_wrench(0.2, placed.origin, jnp.array([0.0, 0.0, -9.81]))
    return hand, posture, contacts, grasp, wrench


@pytest.mark.slow
def test_forces_of_a_grip_obey_the_hands_torques(held):
    hand, posture, contacts, grasp, wrench = held
    free = jaxgrasp.constrained_optimum(grasp, wrench)
    torques = torques_by_virtual_work(hand, posture, np.asarray(contacts.points), np.asarray(free.forces))
    # Seven tenths of the largest torque that the grip would ask for; of the little finger it is not known.
    weak = np.where([name.startswith("little") for name in hand.joints], np.inf, 0.7 * np.abs(torques).max())
    assert (np.abs(torques) > weak).any()
    strong = eqx.tree_at(lambda h: h.torque_max, hand, jnp.asarray(weak), is_leaf=lambda x: x is None)
    limits = torque_limits(strong, posture, contacts)
    jaxgrasp.check_limits(limits, grasp)
    solution = jaxgrasp.constrained_optimum(grasp, wrench, limits=limits)
    assert solution.verdict <= Verdict.OPTIMAL
    limited_torques = torques_by_virtual_work(hand, posture, np.asarray(contacts.points), np.asarray(solution.forces))
    assert (np.abs(limited_torques) <= weak + 1e-6 * np.abs(torques).max()).all()
    # One of them binds, or the limits would have changed nothing.
    assert np.isclose(np.abs(limited_torques), weak, rtol=1e-6).any()


@pytest.mark.slow
def test_the_callers_torques_go_before_the_hands_and_batches_are_many_postures(held):
    hand, posture, contacts, _, _ = held
    bounds = np.arange(19.0)
    single = torque_limits(hand, posture, contacts, bounds)
    np.testing.assert_array_equal(single.torque_max, bounds)
    several = jax.tree.map(lambda x: jnp.stack([x, x]), (posture, contacts))
    batched = torque_limits(hand, *several, bounds)
    assert batched.torque_map.shape == (2, 19, 3, 19) and batched.torque_max.shape == (2, 19)
    np.testing.assert_allclose(batched.torque_map[1], single.torque_map, atol=1e-12)


def test_a_mirrored_hand_is_as_strong(held):
    strong = eqx.tree_at(lambda h: h.torque_max, held[0], jnp.arange(19.0), is_leaf=lambda x: x is None)
    np.testing.assert_array_equal(mirrored(strong).torque_max, np.arange(19.0))


def test_what_says_nothing_of_torques_is_refused(held, unchecked):
    hand, posture, contacts, _, _ = held
    with pytest.raises(ValueError, match="torque_max is None and the hand has no torque limits"):
        torque_limits(hand, posture, contacts)
    with pytest.raises(ValueError, match=r"torque_max has shape \(3,\): expected \(19,\)"):
        torque_limits(hand, posture, contacts, np.ones(3))
