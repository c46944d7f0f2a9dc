"""Joints that follow others: MuJoCo's own residuals are zero at our angles, and motors hold what virtual work says."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.hand import (
    Box,
    Contacts,
    Pose,
    Posture,
    clamp_posture,
    close_hand,
    find_contacts,
    pose_hand,
    torque_limits,
)
from jaxgrasp.interop import hand_from_mujoco, hand_from_urdf

mujoco = pytest.importorskip("mujoco")

STEP = 1e-6


def model(tied: str, motors: str = "") -> object:
    """Return a model of four hinges in a row, and a slide."""
    bodies = "".join(
        f'<body pos="0 0 0.04"><joint name="j{i}" axis="0 1 0" range="-60 60" ref="{5 * i}"/>'
        '<geom type="capsule" size="0.008" fromto="0 0 0 0 0 0.03"/>'
        for i in range(4)
    )
    slide = '<body><joint name="s" type="slide" axis="0 0 1" range="-0.05 0.05"/><geom size="0.008"/></body>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body name="palm"><geom size="0.02"/>{bodies}{slide}{"</body>" * 4}</body></worldbody>'
        f"{tied}<actuator>{motors}</actuator></mujoco>"
    )


def equality(text: str) -> str:
    return f"<equality>{text}</equality>"


FIXED = '<tendon><fixed name="t"><joint joint="j0" coef="0.01"/><joint joint="j1" coef="-0.02"/></fixed>{}</tendon>'
LINEAR = {
    "one": (equality('<joint joint1="j1" joint2="j0" polycoef="0.1 0.5"/>'), 4),
    "backwards": (equality('<joint joint1="j0" joint2="j2" polycoef="-0.05 -0.8"/>'), 4),
    "chain": (equality('<joint joint1="j2" joint2="j1" polycoef="0 2"/><joint joint1="j1" joint2="j0"/>'), 3),
    "two of one": (equality('<joint joint1="j1" joint2="j0"/><joint joint1="s" joint2="j0" polycoef="0 0.02"/>'), 3),
    "in a ring": (
        equality('<joint joint1="j1" joint2="j0"/><joint joint1="j2" joint2="j1"/><joint joint1="j2" joint2="j0"/>'), 3
    ),
    "fixed": (equality('<joint joint1="j3" polycoef="0.2"/>'), 4),
    "tendon": (FIXED.format("") + equality('<tendon tendon1="t"/>'), 4),
    "tendons": (
        FIXED.format('<fixed name="u"><joint joint="j2" coef="0.01"/><joint joint="j3" coef="0.01"/></fixed>')
        + equality('<tendon tendon1="t" tendon2="u" polycoef="0.001 0.5"/>'),
        4,
    ),
    "tight": (FIXED.format("").replace('name="t"', 'name="t" range="-1e-12 1e-12"'), 4),
}  # fmt: skip


@pytest.mark.parametrize("name", LINEAR)
def test_the_law_is_mujocos(name):
    """At angles that obey it, MuJoCo's equalities are met exactly, and tendons are as long as they must be."""
    tied, count = LINEAR[name]
    compiled = model(tied)
    hand = hand_from_mujoco(compiled, "palm")
    coupling = hand.hand.coupling
    assert hand.coupled == () and len(coupling.independent) == count
    data = mujoco.MjData(compiled)
    rng = np.random.default_rng(0)
    for angles in rng.uniform(-0.3, 0.3, (5, 5)):
        data.qpos[hand.addresses] = positions = np.asarray(coupling.angles(angles))
        mujoco.mj_forward(compiled, data)
        independent = list(coupling.independent)
        np.testing.assert_allclose(positions[independent], angles[independent])
        met = data.efc_pos[: data.ne] if name != "tight" else data.ten_length
        np.testing.assert_allclose(met, 0, atol=1e-12)
        assert len(met)


@pytest.mark.parametrize(
    ("tied", "reason"),
    [
        (equality('<joint joint1="j1" joint2="j0" polycoef="0 1 0.5"/>'), "the law is not linear"),
        (FIXED.format("").replace('name="t"', 'name="t" range="-0.02 0.02"'), "its range lets them move apart"),
        (
            equality('<joint joint1="j1" joint2="j0"/><joint joint1="j2" joint2="j1"/>'
                     '<joint joint1="j2" joint2="j0" polycoef="0.3 1"/>'),
            "it contradicts the other couplings",
        ),
    ],
)  # fmt: skip
def test_what_is_no_law_is_named(tied, reason):
    hand = hand_from_mujoco(model(tied), "palm")
    (note,) = hand.coupled
    assert reason in note.why and "'j0'" in note.part


def test_an_equality_that_is_off_ties_nothing_and_a_locked_joint_counts_as_it_stands():
    tied = equality('<joint joint1="j1" joint2="j0" polycoef="0 0.5"/>')
    assert hand_from_mujoco(model(tied.replace("<joint", '<joint active="false"')), "palm").hand.coupling is None
    hand = hand_from_mujoco(model(tied), "palm", locked={"j0": 0.2})
    first = hand.hand.joints.index("j1")
    turned = np.asarray(hand.hand.coupling.angles(np.full(4, 0.1)))
    assert turned[first] == pytest.approx(np.radians(5) + 0.1) and first not in hand.hand.coupling.independent


def test_limits_are_such_that_no_follower_passes_its_own():
    hand = hand_from_mujoco(model(equality('<joint joint1="j1" joint2="j0" polycoef="0 -4"/>')), "palm").hand
    for end in (np.asarray(hand.lower), np.asarray(hand.upper)):
        clamped = np.asarray(clamp_posture(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), 2 * end)).angles)
        assert np.all(clamped >= np.asarray(hand.lower) - 1e-9) and np.all(clamped <= np.asarray(hand.upper) + 1e-9)
        assert clamped[1] == pytest.approx(np.radians(5) - 4 * clamped[0])


@pytest.mark.parametrize(
    ("motors", "expected"),
    [
        ('<motor joint="j0" forcerange="-2 3"/>', 2),
        ('<motor joint="j1" forcerange="-2 3"/>', 1),  # at the follower, which turns half as far
        ('<motor joint="j0" forcerange="-2 2"/><motor joint="j1" forcerange="-2 2"/>', 3),
        ("", np.inf),
    ],
)
def test_a_motor_counts_at_the_joint_that_others_follow(motors, expected):
    """With a motor at the follower alone, the follower leads, by the inverse of the law."""
    hand = hand_from_mujoco(model(equality('<joint joint1="j1" joint2="j0" polycoef="0 0.5"/>'), motors), "palm").hand
    leader = hand.coupling.independent[int(np.argmax(np.abs(hand.coupling.matrix[1])))]
    along_first = 1.0 if leader == 0 else 0.5
    torque_max = np.full(5, np.inf) if hand.torque_max is None else np.asarray(hand.torque_max)
    assert along_first * torque_max[leader] == pytest.approx(expected)
    assert np.isinf(torque_max[1 - leader])


MIMIC = """
<robot name="finger">
  <link name="palm"><collision><geometry><box size="0.04 0.04 0.02"/></geometry></collision></link>
  <link name="near"><collision><origin xyz="0 0 0.02"/><geometry><capsule radius="0.008" length="0.04"/></geometry>
  </collision></link>
  <link name="far"><collision><origin xyz="0 0 0.02"/><geometry><capsule radius="0.008" length="0.04"/></geometry>
  </collision></link>
  <joint name="driven" type="revolute"><parent link="palm"/><child link="near"/><origin xyz="0 0 0.02"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="1.5" effort="0.3" velocity="1"/></joint>
  <joint name="mimic" type="revolute"><parent link="near"/><child link="far"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="1.2" effort="0.3" velocity="1"/>
    <mimic joint="driven" multiplier="0.8" offset="0.1"/></joint>
</robot>
"""
ORIGIN = Pose(jnp.zeros(3), jnp.eye(3))


@pytest.fixture
def finger(tmp_path: Path):
    (tmp_path / "finger.urdf").write_text(MIMIC)
    return hand_from_urdf(tmp_path / "finger.urdf", "palm").hand


def touching(hand, posture: Posture) -> Contacts:
    """Return contacts at the tip alone, which presses along x."""
    contacts = find_contacts(hand, posture, Box(0.1, 0.1, 0.1), Pose(jnp.array([0.0, 0.0, 9.0]), jnp.eye(3)))
    frames = pose_hand(hand, posture).links
    tip = frames.origin[-1] + frames.rotation[-1] @ jnp.array([0.0, 0.0, 0.04])
    return eqx.tree_at(lambda c: c.points, contacts, jnp.broadcast_to(tip, contacts.points.shape))


def test_the_motor_of_a_mimic_joint_holds_the_torques_of_both(finger):
    """Virtual work gives the limit: the tip's displacement as the motor turns and the law moves the other joint."""
    assert finger.coupling.independent == (0,)
    start = jnp.array([0.3, 0.8 * 0.3 + 0.1])
    np.testing.assert_allclose(finger.coupling.angles(jnp.array([0.3, 9.0])), start, atol=1e-12)
    posture = Posture(ORIGIN, start)
    contacts = touching(finger, posture)
    limits = torque_limits(finger, posture, contacts)
    assert limits.torque_map.shape == (3, 3, 1)
    np.testing.assert_array_equal(limits.torque_max, [0.3])
    tips = []
    for step in (STEP, -STEP):
        moved = Posture(ORIGIN, start + step * jnp.array([1.0, 0.8]))
        tips.append(np.asarray(touching(finger, moved).points)[-1])
    np.testing.assert_allclose(limits.torque_map[-1, :, 0], (tips[0] - tips[1]) / (2 * STEP), atol=1e-8)
    # Each joint's torque is below 0.3 N.m, that of the motor, with what it carries for the other, is not.
    by_joint = torque_limits(eqx.tree_at(lambda h: h.coupling, finger, None), posture, contacts)
    along = np.asarray(by_joint.torque_map)[-1, 0]
    force = 0.95 * 0.3 / np.abs(along).max()
    assert np.all(np.abs(force * along) < 0.3) and abs(force * float(limits.torque_map[-1, 0, 0])) > 0.3


@pytest.mark.slow
def test_a_hold_that_the_motor_cannot_give_is_not_granted(finger):
    """A push of the tip that needs 0.329 N.m of the motor, which has 0.3, and less at each joint alone."""
    posture = Posture(ORIGIN, finger.coupling.angles(jnp.array([0.3, 0.0])))
    contacts = touching(finger, posture)
    tip = contacts.points[-1]
    load = 0.329 / abs(float(torque_limits(finger, posture, contacts).torque_map[-1, 0, 0]))
    points = jnp.stack([tip, tip, tip])
    grasp = Grasp(
        points=points,
        normals=jnp.array([[1.0, 0, 0]] * 3),
        friction=jnp.full(3, 0.5),
        squeeze=jnp.ones(3),
        present=jnp.array([0.0, 0.0, 1.0]),
    )
    push = jnp.array([load, 0.0, 0.0])
    wrench = jnp.concatenate([push, jnp.cross(tip, push)])
    coupled_limits = torque_limits(finger, posture, contacts)
    uncoupled_limits = torque_limits(eqx.tree_at(lambda h: h.coupling, finger, None), posture, contacts)
    assert jaxgrasp.constrained_optimum(grasp, wrench, limits=uncoupled_limits).verdict <= Verdict.OPTIMAL
    assert jaxgrasp.constrained_optimum(grasp, wrench, limits=coupled_limits).verdict == Verdict.INFEASIBLE
    assert jaxgrasp.constrained_optimum(grasp, 0.9 * wrench, limits=coupled_limits).verdict <= Verdict.OPTIMAL


def test_a_finger_closes_by_its_law(finger):
    """Whichever link touches first, both stop, and the angles obey the law all the way."""
    start = Posture(ORIGIN, jnp.zeros((3, 2)))
    # In the way of the far link, of the near one, and out of reach.
    place = jnp.array([[0.085, 0, 0.08], [0.075, 0, 0.03], [9.0, 0, 0]])
    shape = Box(0.1, 0.1, 0.02)
    closed, contacts = close_hand(finger, start, shape, Pose(place, jnp.broadcast_to(jnp.eye(3), (3, 3, 3))))
    angles = np.asarray(closed.angles)
    np.testing.assert_allclose(angles[:, 1], 0.8 * angles[:, 0] + 0.1, atol=1e-9)
    assert np.all(angles >= np.asarray(finger.lower) - 1e-9) and np.all(angles <= np.asarray(finger.upper) + 1e-9)
    depths = np.asarray(jax.device_get(contacts.depths))
    assert depths[0, 2] >= 1e-3 and depths[1, 1:].max() >= 1e-3 and angles[0, 0] > 0.01
    np.testing.assert_allclose(angles[2, 0], finger.upper[0], atol=1e-9)
