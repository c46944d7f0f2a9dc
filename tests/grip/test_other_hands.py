"""Power grips of hands that are not human: the Shadow hand by its links' names, the Allegro hand by the user's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Verdict
from jaxgrasp.grip import GripType, grip_type, power_grip, precision_grip
from jaxgrasp.hand import (
    Cylinder,
    Hand,
    check_posture,
    closing_kinematics,
    grasp_from_contacts,
    human_hand,
    mirrored,
    name_fingers,
    torque_limits,
)
from jaxgrasp.interop import hand_from_mujoco, hand_from_urdf
from tests.interop.test_mujoco_hand import allegro, model_of

mujoco = pytest.importorskip("mujoco")
ROD = Cylinder(0.025, 0.12)
THUMB = {"open": {"robot0:THJ3": 1.2}, "closed": {"robot0:THJ4": 1.047}}
"""The Shadow hand's thumb stands off its palm, and comes round as the hand closes [rad]."""
ALLEGRO = {"palm_link": ("middle", "palm")} | {
    f"link_{4 * finger + i}.0": (name, phalanx)
    for finger, name in enumerate(("index", "middle", "ring"))
    for i, phalanx in enumerate(("proximal", "middle", "distal"), 1)
}
ALLEGRO |= {f"link_{13 + i}.0": ("thumb", kind) for i, kind in enumerate(("metacarpal", "proximal", "distal"))}


def nameless(hand: Hand) -> Hand:
    """Return the hand with meaningless joint names, so that only its links' names tell about it."""
    return Hand(**{**vars(hand), "joints": tuple(f"joint {i}" for i in range(len(hand.joints)))})


@pytest.mark.parametrize("side", ["right", "left"])
def test_what_is_found_of_a_human_hand_is_what_is_known_of_it(side):
    hand = human_hand(side=side)
    expected = closing_kinematics(hand)
    kinematics = closing_kinematics(nameless(hand), open={"joint 0": float(expected.open[0])})
    np.testing.assert_array_equal(kinematics.open, expected.open)
    np.testing.assert_array_equal(kinematics.closed, expected.closed)
    np.testing.assert_allclose(kinematics.frame, expected.frame, atol=1e-12)
    assert abs(kinematics.seat[0] - expected.seat[0]) < 0.01


def test_where_the_wrists_frame_stands_in_the_hand_does_not_matter():
    """The same hand in turned axes: the same grip, seen from there."""
    hand, turn = human_hand(), np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    first = np.array(hand.parents) < 0
    origins = jnp.where(first[:, None], hand.origins @ turn.T, hand.origins)
    rests = jnp.where(first[:, None, None], turn @ hand.rests, hand.rests)
    palms = np.array([link.joint < 0 for link in hand.links])
    centers = jnp.where(palms[:, None, None], hand.skin.centers @ turn.T, hand.skin.centers)
    skin = type(hand.skin)(centers, hand.skin.radii)
    turned = Hand(**{**vars(nameless(hand)), "origins": origins, "rests": rests, "skin": skin})
    open_thumb = {"joint 0": 0.6}
    grip = power_grip(nameless(hand), ROD, closing=closing_kinematics(nameless(hand), open=open_thumb))
    turned_grip = power_grip(turned, ROD, closing=closing_kinematics(turned, open=open_thumb))
    np.testing.assert_allclose(turned_grip[0].angles, grip[0].angles, atol=1e-9)
    np.testing.assert_allclose(turned_grip[1].origin, grip[1].origin, atol=1e-9)
    np.testing.assert_allclose(turned_grip[2].points, grip[2].points, atol=1e-6)


@pytest.fixture(scope="module")
def shadow():
    """Return the Shadow hand's model, the hand as read, the hand with named fingers, and its grip of a cylinder."""
    model, wrist, _ = model_of("shadow")
    hand_read = hand_from_mujoco(model, wrist)
    hand = name_fingers(hand_read.hand)
    return model, hand_read, hand, power_grip(hand, ROD, closing=closing_kinematics(hand, **THUMB))


def test_the_shadow_hands_fingers_have_their_names(shadow):
    names = [link.name for link in shadow[2].links]
    assert {f"{f} {p}" for f in ("index", "middle", "ring", "little") for p in ("proximal", "middle", "distal")} <= set(
        names
    )
    assert {"middle palm", "little palm", "thumb metacarpal", "thumb proximal", "thumb distal"} <= set(names)
    # What is no phalanx keeps its name.
    assert {"robot0:thbase", "robot0:thhub"} <= set(names) and len(names) == 19


@pytest.mark.slow
def test_the_shadow_hand_closes_around_a_cylinder_and_holds_it(shadow):
    _, _, hand, (posture, placed, contacts) = shadow
    check_posture(hand, posture)
    assert int(grip_type(hand, posture, contacts)) == GripType.CYLINDRICAL_POWER
    touching = {link.finger for link, is_touching in zip(hand.links, contacts.present, strict=True) if is_touching > 0}
    assert {"thumb", "index", "middle", "ring", "little"} <= touching
    # On the cylinder's surface, by its equation, and as deep as was asked, but for a step of the way.
    local = (np.asarray(contacts.points) - placed.origin) @ placed.rotation
    is_present = np.asarray(contacts.present) > 0
    np.testing.assert_allclose(np.hypot(*local[is_present, :2].T), 0.025, atol=2e-4)
    assert np.abs(local[is_present, 2]).max() <= 0.06
    depths = np.asarray(contacts.depths)[is_present]
    assert depths.min() > 0.9e-3 and depths.max() < 1.5e-3
    grasp = grasp_from_contacts(contacts, friction=0.6, stiffness=1000.0)
    weight = jaxgrasp.weight_wrench(0.3, placed.origin, jnp.array([0.0, 0.0, -9.81]))
    assert jaxgrasp.constrained_optimum(grasp, weight).verdict <= Verdict.OPTIMAL


@pytest.mark.slow
def test_its_forces_obey_its_motors_by_mujocos_jacobians(shadow):
    model, hand_read, hand, (posture, placed, contacts) = shadow
    # So firm a squeeze asks more of some motors than they have.
    grasp = grasp_from_contacts(contacts, friction=0.6, stiffness=20000.0)
    weight = jaxgrasp.weight_wrench(0.3, placed.origin, jnp.array([0.0, 0.0, -9.81]))
    data = mujoco.MjData(model)
    data.qpos[hand_read.addresses] = posture.angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    wrist = model.body("robot0:palm").id
    axes = data.xmat[wrist].reshape(3, 3) @ np.asarray(posture.wrist.rotation).T
    jacobians = np.zeros((len(hand_read.bodies), 3, model.nv))
    for row, body, point in zip(jacobians, hand_read.bodies, np.asarray(contacts.points), strict=True):
        mujoco.mj_jac(model, data, row, None, data.xpos[wrist] + axes @ point, body)
    # Joints that follow others move with them: their torques act on the joints that lead, J_i C (virtual work).
    coupling = np.asarray(hand.coupling.matrix)
    world = np.einsum("ab,lac->lbc", axes, jacobians[:, :, hand_read.velocities]) @ coupling

    def torques(forces) -> np.ndarray:
        return np.einsum("lbj,lb->j", world, np.asarray(forces))

    limits = torque_limits(hand, posture, contacts)
    bound = np.asarray(limits.torque_max)
    is_present = np.asarray(contacts.present) > 0
    np.testing.assert_allclose(np.asarray(limits.torque_map)[is_present], world[is_present], atol=1e-9)
    held = jaxgrasp.constrained_optimum(grasp, weight, limits=limits)
    assert held.verdict <= Verdict.OPTIMAL
    assert (np.abs(torques(held.forces)) <= bound + 1e-7).all()
    # Without them some motors would have to give more.
    assert (np.abs(torques(jaxgrasp.constrained_optimum(grasp, weight).forces)) > 1.01 * bound).any()


@pytest.mark.slow
def test_the_allegro_hand_closes_by_the_users_names():
    hand = name_fingers(hand_from_urdf(allegro(), "palm_link").hand, ALLEGRO)
    kinematics = closing_kinematics(hand, open={"joint_12.0": 1.396})
    # Its file: fingers along z, the palm looks along x.
    np.testing.assert_allclose(kinematics.frame[:, 0], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(kinematics.frame[:, 2], [-1, 0, 0], atol=1e-6)
    posture, placed, contacts = power_grip(hand, Cylinder(0.03, 0.2), closing=kinematics)
    check_posture(hand, posture)
    grasp = grasp_from_contacts(contacts, friction=0.6, stiffness=1000.0)
    weight = jaxgrasp.weight_wrench(0.3, placed.origin, jnp.array([0.0, 0.0, -9.81]))
    limits = torque_limits(hand, posture, contacts)
    assert jaxgrasp.constrained_optimum(grasp, weight, limits=limits).verdict <= Verdict.OPTIMAL


@pytest.mark.slow
def test_the_shadow_hand_holds_by_its_fingertips_alone_whichever_way_is_down(shadow):
    hand, down = shadow[2], np.concatenate([np.eye(3), -np.eye(3)])
    for radius in (0.015, 0.025, 0.035):
        posture, placed, contacts = jax.device_get(
            precision_grip(hand, Cylinder(radius, 0.12), 3, closing=closing_kinematics(hand, **THUMB))
        )
        check_posture(hand, posture)
        is_present = contacts.present > 0
        touching = {link.name for link, touches in zip(hand.links, is_present, strict=True) if touches}
        assert touching == {"thumb distal", "index distal", "middle distal"}
        np.testing.assert_allclose(contacts.depths[is_present], 1e-3, rtol=0.05)
        assert int(grip_type(hand, posture, contacts)) == GripType.PRECISION_3
        grasp = grasp_from_contacts(contacts, friction=0.5, stiffness=1000.0)
        weights = np.stack([jaxgrasp.weight_wrench(0.4, placed.origin, 9.81 * direction) for direction in down])
        assert (jaxgrasp.constrained_optimum(grasp, weights).verdict <= int(Verdict.OPTIMAL)).all()


def test_a_mirrored_hand_closes_as_its_image(shadow):
    hand = mirrored(shadow[2])
    kinematics, shadow_kinematics = closing_kinematics(hand, **THUMB), closing_kinematics(shadow[2], **THUMB)
    np.testing.assert_array_equal(kinematics.closed, shadow_kinematics.closed)
    flip = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(kinematics.frame[:, 0], flip * shadow_kinematics.frame[:, 0], atol=1e-12)
    np.testing.assert_allclose(kinematics.frame[:, 2], flip * shadow_kinematics.frame[:, 2], atol=1e-12)
    np.testing.assert_allclose(kinematics.seat, flip * shadow_kinematics.seat, atol=1e-12)


def test_what_does_not_fit_the_hand_is_refused(shadow):
    hand = shadow[2]
    with pytest.raises(ValueError, match=r"open has 'thumb': expected joints of the hand, such as robot0:FFJ3"):
        closing_kinematics(hand, open={"thumb": 1.0})
    with pytest.raises(ValueError, match=r"closed\['robot0:THJ4'\] is 2.0: expected -1.047 to 1.047"):
        closing_kinematics(hand, closed={"robot0:THJ4": 2.0})
    with pytest.raises(ValueError, match="the link thumb proximal starts .* inside the object"):
        power_grip(hand, ROD, closing=closing_kinematics(hand, open={"robot0:THJ4": 1.0, "robot0:THJ3": 1.2}))
    with pytest.raises(ValueError, match="hand has no palm: expected links named by finger and phalanx"):
        power_grip(shadow[1].hand, ROD)
    with pytest.raises(ValueError, match=r"names has 'ff': expected links of the hand, such as robot0:palm"):
        name_fingers(shadow[1].hand, {"ff": ("index", "distal")})
    with pytest.raises(ValueError, match=r"names\['robot0:palm'\] is \('hand', 'palm'\): expected one of thumb"):
        name_fingers(shadow[1].hand, {"robot0:palm": ("hand", "palm")})
