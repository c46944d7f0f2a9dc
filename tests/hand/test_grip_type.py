"""Kinds of grips: those that a hand really makes, and what cannot change what they are called."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import constrained_optimum
from jaxgrasp.grip import CYLINDRICAL_POWER_GRIP, Contributions, GripType, contributions_of, grip_type, power_grip
from jaxgrasp.hand import (
    Box,
    Contacts,
    Cylinder,
    Hand,
    Pose,
    Posture,
    Sphere,
    closing_kinematics,
    find_contacts,
    grasp_from_contacts,
    human_hand,
    link_contributions,
)
from jaxgrasp.hand.to_grasp import CONTRIBUTIONS
from jaxgrasp.model.solution import is_optimum
from tests.hand.hands import rotations

HAND = human_hand()
LINKS = [link.name for link in HAND.links]
KEY = {"thumb abduction": 0.2, "thumb MP": 0.2, "thumb IP": 0.4, "MP": 1.1, "PIP": 1.2, "DIP": 0.6}
"""Bent fingers, the thumb beside the index [rad]."""
BEAD = np.array([0.0956, 0.0339, -0.0558]), 0.0055
"""A small ball between them: its place and its radius [m]."""
TIPS = {"thumb distal", "index distal", "middle distal", "ring distal", "little distal"}


def key_pinch(hand: Hand) -> tuple[Posture, Contacts]:
    angles = np.array([KEY.get(name, KEY.get(name.split()[1], 0.0)) for name in hand.joints])
    posture = Posture(Pose(np.zeros(3), np.eye(3)), angles)
    return posture, find_contacts(hand, posture, Sphere(BEAD[1]), Pose(BEAD[0], np.eye(3)))


def changed(contacts: Contacts, **fields) -> Contacts:
    return Contacts(**jax.tree.map(jnp.asarray, {**vars(contacts), **fields}))


def stacked(grips: list[tuple[Posture, Contacts]]) -> tuple[Posture, Contacts]:
    return jax.device_get(jax.tree.map(lambda *parts: np.stack(parts), *grips))


@pytest.fixture(scope="module")
def real() -> tuple[Posture, Contacts, list[GripType]]:
    """Return grips of a cylinder and a ball, a key pinch, and an open hand."""
    around = [power_grip(HAND, shape) for shape in (Cylinder(0.03, 0.12), Sphere(0.04))]
    open_hand = Posture(Pose(np.zeros(3), np.eye(3)), np.zeros(19))
    far = find_contacts(HAND, open_hand, Sphere(0.03), Pose(np.ones(3), np.eye(3)))
    kinds = [GripType.CYLINDRICAL_POWER, GripType.SPHERICAL_POWER, GripType.LATERAL, GripType.NONE]
    grips = [(posture, contacts) for posture, _, contacts in around]
    return *stacked([*grips, key_pinch(HAND), (open_hand, far)]), kinds


@pytest.mark.slow
def test_each_grip_that_a_hand_makes_has_its_name(real):
    posture, contacts, kinds = real
    name = grip_type(HAND, posture, contacts)
    assert name.dtype == jnp.int32 and name.tolist() == kinds
    assert [int(grip_type(HAND, *jax.tree.map(lambda x, i=i: x[i], (posture, contacts)))) for i in range(4)] == kinds


@pytest.mark.slow
@pytest.mark.parametrize(
    "make, kind",
    [
        (lambda radius: Cylinder(radius, 0.12), GripType.CYLINDRICAL_POWER),
        (lambda radius: Box(2 * radius, 2 * radius, 0.12), GripType.CYLINDRICAL_POWER),
        (Sphere, GripType.SPHERICAL_POWER),
    ],
)
def test_power_grips_of_all_sizes_and_sides(make, kind):
    for side in ("right", "left"):
        for length in (0.16, 0.19, 0.21):
            hand = human_hand(length, side=side)
            for radius in (0.02, 0.03, 0.04):
                posture, _, contacts = power_grip(hand, make(radius))
                assert int(grip_type(hand, posture, contacts)) == kind, (side, length, radius)


@pytest.mark.slow
@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("shape", [Sphere(0.05), Sphere(0.06), Cylinder(0.05, 0.12), Box(0.09, 0.09, 0.12)])
def test_a_thumb_that_would_start_inside_is_put_aside(shape, side):
    hand = human_hand(side=side)
    _, placed, contacts = power_grip(hand, shape, 2e-3)
    is_thumb = np.array([link.finger == "thumb" for link in hand.links])
    deepest = np.asarray(contacts.depths)[is_thumb].max()
    # It comes back until it presses, to within a step of closing, and opposes the fingers: whichever way is down, the
    # grip holds.
    assert 2e-3 <= deepest < 3e-3
    grasp = grasp_from_contacts(contacts, 0.6, 1000.0)
    weights = 4.0 * np.concatenate([np.eye(3), -np.eye(3)])
    wrenches = np.concatenate([weights, np.cross(np.asarray(placed.origin), weights)], -1)
    assert is_optimum(constrained_optimum(grasp, wrenches).verdict).all()


@pytest.mark.slow
def test_a_finger_that_starts_inside_the_object_is_named():
    closing = closing_kinematics(HAND, open={"index MP": 1.2})
    with pytest.raises(
        ValueError, match=r"the link index \w+ starts 0\.0\d+ m inside the object: expected at most 0.001"
    ):
        power_grip(HAND, Cylinder(0.05, 0.12), 1e-3, closing)


@pytest.mark.slow
def test_an_object_too_thick_for_the_hand_is_refused():
    message = r"the link thumb \w+ starts 0\.0\d+ m inside the object, however far .*: expected at most 0.001 m"
    with pytest.raises(ValueError, match=message):
        power_grip(HAND, Sphere(0.12))


@pytest.mark.slow
@pytest.mark.parametrize("shape", [Cylinder(0.04, 0.12), Box(0.06, 0.06, 0.12), Sphere(0.04)])
def test_an_object_lies_on_the_pads_of_the_palm(shape):
    _, _, contacts = power_grip(human_hand(palm_pads=True), shape, 1e-3)
    assert 1e-3 - 1e-6 < np.asarray(contacts.depths).max() < 2e-3


@pytest.mark.slow
def test_where_hand_and_object_are_and_how_hard_they_press_does_not_matter(real):
    posture, contacts, kinds = real
    rng = np.random.default_rng(0)
    for turn in rotations(5, rng):
        shift = rng.normal(size=3)
        moved = Posture(Pose(posture.wrist.origin @ turn.T + shift, turn @ posture.wrist.rotation), posture.angles)
        moved_contacts = changed(
            contacts,
            points=contacts.points @ turn.T + shift,
            # What is absent says nothing.
            normals=np.where(contacts.present[..., None] > 0, contacts.normals @ turn.T, np.nan),
            depths=contacts.depths * rng.uniform(0.1, 5, contacts.depths.shape),
        )
        assert grip_type(HAND, moved, moved_contacts).tolist() == kinds


@pytest.mark.slow
def test_a_left_hand_makes_the_same_grips(real):
    posture, contacts, kinds = real
    flip = np.array([1.0, -1.0, 1.0])
    wrist = Pose(posture.wrist.origin * flip, flip[:, None] * posture.wrist.rotation * flip)
    mirrored = changed(contacts, points=contacts.points * flip, normals=contacts.normals * flip)
    assert grip_type(human_hand(side="left"), Posture(wrist, posture.angles), mirrored).tolist() == kinds


def test_the_order_of_a_hands_links_does_not_matter(real):
    posture, contacts, kinds = real
    order = np.random.default_rng(1).permutation(len(LINKS))
    hand = Hand(**{**vars(HAND), "links": tuple(HAND.links[i] for i in order)})
    fields = ("points", "normals", "depths", "present")
    reordered = changed(contacts, **{name: getattr(contacts, name)[:, order] for name in fields})
    assert grip_type(hand, posture, reordered).tolist() == kinds


@pytest.mark.parametrize(
    "touching, kind",
    [
        ({"thumb distal", "index distal"}, GripType.PRECISION_2),
        ({"thumb distal", "little distal"}, GripType.PRECISION_2),
        (TIPS - {"ring distal", "little distal"}, GripType.PRECISION_3),
        (TIPS - {"middle distal"}, GripType.PRECISION_4),
        (TIPS, GripType.PRECISION_5),
        (TIPS - {"thumb distal"}, GripType.UNKNOWN),
        ({"thumb distal"}, GripType.UNKNOWN),
        ({"middle palm"}, GripType.UNKNOWN),
        (TIPS | {"ring middle"}, GripType.UNKNOWN),
        (TIPS | {"ring palm"}, GripType.CYLINDRICAL_POWER),
        (TIPS - {"thumb distal"} | {"index proximal"}, GripType.CYLINDRICAL_POWER),
    ],
)
def test_which_links_touch_decides(real, touching, kind):
    """All normals along one line, out of the fingers' pulps."""
    posture, contacts = jax.tree.map(lambda x: x[3], real[:2])
    normals = np.broadcast_to([0.0, 0.0, -1.0], contacts.normals.shape)
    present = np.isin(LINKS, list(touching)).astype(float)
    changed_contacts = changed(contacts, normals=normals, present=present)
    assert int(grip_type(HAND, posture, changed_contacts)) == kind
    unsure = changed(changed_contacts, present=np.where(present > 0, np.nan, 0))
    assert int(grip_type(HAND, posture, unsure)) == GripType.UNKNOWN


def test_contributions_are_table_1_for_a_cylindrical_power_grip_and_the_users_or_1_without_a_table():
    table = link_contributions(HAND, CYLINDRICAL_POWER_GRIP)
    np.testing.assert_array_equal(contributions_of(HAND, GripType.CYLINDRICAL_POWER), table)
    for kind in (GripType.NONE, GripType.UNKNOWN, GripType.PRECISION_2, GripType.LATERAL):
        np.testing.assert_array_equal(contributions_of(HAND, kind), np.ones(len(LINKS)))
    rows = CYLINDRICAL_POWER_GRIP
    mine = Contributions("spherical power", rows.fingers, rows.phalanges, 2 * rows.values, "a test")
    tables = {**CONTRIBUTIONS, GripType.SPHERICAL_POWER: mine}
    np.testing.assert_array_equal(
        contributions_of(HAND, GripType.SPHERICAL_POWER, tables), link_contributions(HAND, mine)
    )
    np.testing.assert_array_equal(contributions_of(HAND, GripType.CYLINDRICAL_POWER, tables), table)


def test_digits_of_a_spherical_power_grip_share_as_measured():
    """By Kinoshita et al. (1996) and Pylatiuk et al. (2006); the whole squeeze is that of 1 for each digit."""
    by_link = dict(zip(LINKS, np.asarray(contributions_of(HAND, GripType.SPHERICAL_POWER)).tolist(), strict=True))
    shares = {digit: by_link[f"{digit} distal"] / 5 for digit in ("thumb", "index", "middle", "ring", "little")}
    assert sum(shares.values()) == pytest.approx(1)
    assert shares["thumb"] >= 0.38 and shares["index"] == min(shares.values()) >= 0.11
    assert 0.18 <= shares["ring"] == shares["little"] <= 0.23
    assert shares["thumb"] + shares["ring"] + shares["little"] > 0.71
    assert all(by_link[f"{finger} palm"] == 1 for finger in ("index", "middle", "ring", "little"))


@pytest.mark.parametrize("n_digits", [3, 4, 5])
def test_fingers_of_a_precision_grip_share_as_measured_and_the_thumb_opposes_them_all(n_digits):
    """By Radwin et al. (1992): 33, 33, 17 and 15 % of a five-finger pinch; the whole squeeze is that of 1 for each."""
    by_link = dict(zip(LINKS, np.asarray(contributions_of(HAND, GripType(n_digits))).tolist(), strict=True))
    digits = ["thumb", "index", "middle", "ring", "little"][:n_digits]
    tips = {digit: by_link[f"{digit} distal"] for digit in digits}
    assert sum(tips.values()) == pytest.approx(n_digits)
    assert tips["thumb"] == pytest.approx(sum(c for digit, c in tips.items() if digit != "thumb"))
    measured = {"index": 33, "middle": 33, "ring": 17, "little": 15}
    for digit in digits[1:]:
        assert tips[digit] / tips["index"] == pytest.approx(measured[digit] / 33)
    assert CONTRIBUTIONS[GripType(n_digits)].source.startswith("Radwin")
