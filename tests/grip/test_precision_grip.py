"""Precision grips: fingertips alone touch, as deep as wanted, and hold the object whichever way it is turned."""

from collections.abc import Callable
from itertools import product

import jax
import numpy as np
import pytest

from jaxgrasp import Verdict, constrained_optimum, weight_wrench
from jaxgrasp.grip import GripType, grip_type, power_grip, precision_grip
from jaxgrasp.grip.precision_grip import fingertip_task
from jaxgrasp.hand import (
    Box,
    Capsule,
    Cylinder,
    Hand,
    Posture,
    Shape,
    Sphere,
    check_posture,
    closing_kinematics,
    find_contacts,
    grasp_from_contacts,
    human_hand,
)
from jaxgrasp.hand.closing import link_overlaps, phalanx_pairs

FRICTION, STIFFNESS, MASS = 0.5, 1000.0, 0.4
DOWN = np.concatenate([np.eye(3), -np.eye(3)])
SHAPES: dict[str, Callable[[float], Shape]] = {
    "cylinder": lambda radius: Cylinder(radius, 0.12),
    "sphere": Sphere,
    "box": lambda radius: Box(2 * radius, 2 * radius, 0.12),
    "capsule": lambda radius: Capsule(radius, 0.08),
}
KINDS = [(3, "cylinder"), (5, "sphere")]
MORE = [(fingers, name) for fingers in (3, 4, 5) for name in SHAPES]


def assert_held_by_its_tips(hand: Hand, shape: Shape, fingers: int, depth: float) -> None:
    posture, placed, contacts = jax.device_get(precision_grip(hand, shape, fingers, depth))
    check_posture(hand, posture)
    touching = [link for link, is_present in zip(hand.links, contacts.present, strict=True) if is_present]
    assert [link.finger for link in touching] == ["thumb", "index", "middle", "ring", "little"][:fingers]
    assert {link.phalanx for link in touching} == {"distal"}
    np.testing.assert_allclose(contacts.depths[contacts.present > 0], depth, rtol=0.05)
    contacts_again = find_contacts(hand, posture, shape, placed)
    np.testing.assert_allclose(contacts_again.points, contacts.points, atol=1e-12)
    grasp = grasp_from_contacts(contacts, FRICTION, STIFFNESS)
    weights = np.stack([weight_wrench(MASS, placed.origin, 9.81 * down) for down in DOWN])
    verdicts = np.asarray(constrained_optimum(grasp, weights).verdict)
    assert np.isin(verdicts, (Verdict.OPTIMAL, Verdict.CLOSED_FORM_OPTIMAL)).all(), verdicts
    assert int(grip_type(hand, posture, contacts)) == getattr(GripType, f"PRECISION_{fingers}")
    # Fingers meet by less than 1 mm more than in the open hand.
    pairs, opened = phalanx_pairs(hand), Posture(posture.wrist, closing_kinematics(hand).open)
    overlaps, open_overlaps = link_overlaps(hand, posture, pairs), link_overlaps(hand, opened, pairs)
    assert (overlaps <= np.maximum(0, open_overlaps) + 1e-3).all()


def test_a_task_has_two_directions_in_each_fingertip_and_the_joints_that_close_it():
    hand = human_hand()
    closing = closing_kinematics(hand)
    task = fingertip_task(hand, Sphere(0.03), 1e-3, ("thumb", "index", "middle"), closing)
    assert task.closing is closing and [hand.links[tip].finger for tip in task.tips] == list(task.fingers)
    for finger, chain in zip(task.fingers, task.flexions, strict=True):
        assert {hand.joints[joint].split()[0] for joint in chain} == {finger}
        assert np.all(np.asarray(closing.closed)[list(chain)] != np.asarray(closing.open)[list(chain)])
    np.testing.assert_allclose(np.linalg.norm(task.pulps, axis=-1), 1)
    np.testing.assert_allclose(np.sum(np.asarray(task.pulps) * task.sides, -1), 0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("fingers, name", KINDS)
def test_fingertips_alone_hold_it_whichever_way_is_down(fingers, name):
    for length, side, radius, depth in ((0.16, "right", 0.035, 1e-3), (0.21, "left", 0.015, 2e-3)):
        assert_held_by_its_tips(human_hand(length, side=side), SHAPES[name](radius), fingers, depth)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("fingers, name", MORE)
def test_the_stated_range_is_reached_to_its_corners(fingers, name):
    for length, side, radius in product((0.16, 0.21), ("right", "left"), (0.015, 0.025, 0.035)):
        assert_held_by_its_tips(human_hand(length, side=side), SHAPES[name](radius), fingers, 1e-3)


@pytest.mark.slow
def test_what_is_out_of_reach_is_named(unchecked):
    hand = human_hand()
    # Fingertips reach it, all from one side.
    with pytest.raises(ValueError, match="on this Cylinder was found: the thumb cannot oppose the fingers"):
        precision_grip(hand, Cylinder(0.2, 0.12), 3)
    with pytest.raises(ValueError, match="precision grip of 5 fingers on this Sphere was found: .*too little room"):
        precision_grip(hand, Sphere(0.003), 5)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((Sphere(0.03), 2), "fingers is 2: expected 3, 4 or 5"),
        ((Sphere(0.0), 3), "Sphere.radius is 0.0"),
        ((Sphere(0.03), 3, 0.0), r"depth is 0.0: expected a positive number \[m\]"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        precision_grip(human_hand(), *arguments)


def test_a_hand_of_another_make_is_refused():
    hand = human_hand()
    strange = Hand(**{**vars(hand), "links": tuple(link._replace(finger="claw", phalanx="") for link in hand.links)})
    for grip in (power_grip, precision_grip):
        with pytest.raises(ValueError, match="hand has no palm: expected links named by finger and phalanx"):
            grip(strange, Sphere(0.03))
    links = tuple(link._replace(finger=link.finger.replace("thumb", "claw")) for link in hand.links)
    headless = Hand(**{**vars(hand), "links": links, "joints": tuple(map(str, range(19)))})
    with pytest.raises(ValueError, match="hand has no link thumb distal: expected links named as name_fingers does"):
        precision_grip(headless, Sphere(0.03))
