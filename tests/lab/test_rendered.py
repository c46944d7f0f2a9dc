"""Rendering of the torques that the same instant's physics asks for.

Everything expected here is computed apart from what renders it: accelerations are second differences of where the
object was, forces are solved with NumPy, torques are the work of the forces as joints move.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip import Hold, monitor, observe
from jaxgrasp.grip.contact_forces import ContactForces, cut_to_cones, resultant
from jaxgrasp.grip.tick import find_touches
from jaxgrasp.hand import Posture
from jaxgrasp.hand.to_grasp import GripType, contributions_of, grip_type
from jaxgrasp.lab.grasp_and_lift import cylinder_scene
from jaxgrasp.lab.haptic_loop import Haptics, pose_at
from jaxgrasp.lab.haptic_tick import BLENDING_TIME, SETTLING_TIME, first_grip, grip_tables, next_grip
from jaxgrasp.model.grasp import Grasp
from tests.lab.joint_work import MODEL, by_work

pytestmark = pytest.mark.slow
DT, UP = 0.01, 5.0
"""Between two ticks [s]; how the wrist is accelerated upward [m/s^2]."""


@pytest.fixture(scope="module")
def scene():
    return cylinder_scene()


def lifted(scene, law: str, ticks: int = 12, smoothing: float = 0.0) -> tuple[Haptics, list, list, np.ndarray]:
    """Lift with steady acceleration; return the haptics, the torques and heights of each tick, and the angles."""
    made, closed, placed = scene
    haptics = Haptics(made, MODEL, np.asarray(closed.angles), placed, law, smoothing)
    angles = np.asarray(closed.angles)[list(MODEL.joint_indices(made.hand.joints))]
    torques, heights = [], []
    for k in range(ticks):
        wrist = pose_at(jnp.array([0.0, 0.0, UP * (k * DT) ** 2 / 2]))
        torques.append(haptics.tick(k * DT, angles, wrist).torques)
        heights.append(np.asarray(haptics.placed.origin))
    return haptics, torques, heights, angles


def closed_by_numpy(grasp: Grasp, wrench: np.ndarray) -> np.ndarray:
    """Solve method B from its definition: the weighted least squares of the deviations from squeezing."""
    is_present = np.asarray(grasp.present) > 0
    points, normals = (np.asarray(x)[is_present] for x in (grasp.points, grasp.normals))
    squeeze = np.asarray(grasp.squeeze)[is_present]
    matrix = np.concatenate([np.concatenate([np.eye(3), np.cross(np.eye(3), -p).T]) for p in points], 1)
    squeeze_forces = (squeeze[:, None] * normals).ravel()
    root = np.sqrt(np.repeat(squeeze, 3))
    more = root * np.linalg.lstsq(matrix * root, wrench - matrix @ squeeze_forces, rcond=None)[0]
    forces = np.zeros(np.asarray(grasp.points).shape)
    forces[is_present] = (squeeze_forces + more).reshape(-1, 3)
    return forces


def last_instant(scene, haptics: Haptics, heights: list, angles: np.ndarray, ticks: int):
    """Return posture, object and wrench of the last tick, from the object's positions and nothing else."""
    made, closed, _ = scene
    wrist = pose_at(jnp.array([0.0, 0.0, UP * ((ticks - 1) * DT) ** 2 / 2]))
    posture = Posture(wrist, np.asarray(closed.angles))
    gained = (heights[-1] - 2 * heights[-2] + heights[-3]) / DT**2
    wrench = np.append(made.body.mass * (gained - np.asarray(made.gravity)), np.zeros(3))
    return posture, gained, wrench


@pytest.mark.parametrize("law", ["closed-form", "optimum"])
def test_what_the_contacts_exert_moves_the_object(scene, law):
    """Newton's second law between what is recorded of forces and of places; by the closed form this grip slips."""
    made, closed, placed = scene
    haptics = Haptics(made, MODEL, np.asarray(closed.angles), placed, law, 0.0)
    angles = np.asarray(closed.angles)[list(MODEL.joint_indices(made.hand.joints))]
    record = []
    for k in range(12):
        haptics.tick(k * DT, angles, pose_at(jnp.array([0.0, 0.0, UP * (k * DT) ** 2 / 2])))
        record.append(haptics.instant)
    heights = np.array([instant.placed.origin[2] for instant in record[1:]])
    for k in range(1, len(heights) - 1):
        gained = (heights[k + 1] - 2 * heights[k] + heights[k - 1]) / DT**2
        # What slips down onto the table is stopped there.
        if record[k + 1].stands:
            continue
        force = np.asarray(record[k + 1].exerted).sum(0)[2] + record[k + 1].tick.support[2]
        assert force == pytest.approx(made.body.mass * (gained + 9.81), rel=1e-6)
    held = record[-1].hold == Hold.STABLE
    assert held == (law == "optimum") and (abs(gained - UP) < 1e-6) == held


def test_a_lifted_object_is_felt_with_its_inertia(scene):
    haptics, torques, heights, angles = lifted(scene, "closed-form")
    posture = Posture(pose_at(jnp.array([0.0, 0.0, UP * (11 * DT) ** 2 / 2])), np.asarray(scene[1].angles))
    weight = np.append(-scene[0].body.mass * np.asarray(scene[0].gravity), np.zeros(3))
    gained = np.asarray(haptics.instant.tick.inertial)
    assert gained[2] > 0.1 * weight[2]
    contacts, grasp, _ = find_touches(scene[0], posture, haptics.placed)
    torques_felt, at_rest = (
        by_work(
            scene[0].hand,
            posture,
            np.asarray(contacts.points),
            np.asarray(cut_to_cones(grasp, ContactForces(forces)).forces),
        )
        for forces in (closed_by_numpy(grasp, weight + gained), closed_by_numpy(grasp, weight))
    )
    np.testing.assert_allclose(np.abs(torques[-1]), np.abs(torques_felt), atol=1e-6)
    assert np.abs(torques_felt - at_rest).max() > 5e-4


def test_what_is_felt_balances_what_moves_by_the_optimum(scene):
    haptics, torques, heights, angles = lifted(scene, "optimum")
    posture, gained, wrench = last_instant(scene, haptics, heights, angles, 12)
    contacts, grasp, _ = find_touches(scene[0], posture, haptics.placed)
    held = observe(
        scene[0],
        posture,
        haptics.placed,
        wrench - np.append(-scene[0].body.mass * np.asarray(scene[0].gravity), np.zeros(3)),
        law="optimum",
    )
    assert held.assessment.hold == Hold.STABLE
    forces = np.asarray(held.exerted)
    # Judged by their own laws: they balance mass and acceleration, and stay inside the cones.
    np.testing.assert_allclose(np.asarray(resultant(grasp.points, forces)), wrench, atol=1e-8)
    np.testing.assert_allclose(cut_to_cones(grasp, ContactForces(forces)).forces, forces, atol=1e-9)
    assert gained[2] == pytest.approx(UP, rel=1e-6)
    expected = by_work(scene[0].hand, posture, np.asarray(contacts.points), forces)
    np.testing.assert_allclose(np.abs(torques[-1]), np.abs(expected), atol=1e-6)
    by_closed_form = lifted(scene, "closed-form")[1]
    assert np.abs(torques[-1] - by_closed_form[-1]).max() > 1e-3


def test_smoothing_delays_and_loses_nothing(scene):
    _, plain, _, _ = lifted(scene, "optimum", ticks=16)
    _, smooth, _, _ = lifted(scene, "optimum", ticks=16, smoothing=0.02)
    apart = [np.abs(a - b).max() for a, b in zip(plain, smooth, strict=True)]
    assert apart[3] > 3 * apart[-1]


@pytest.mark.parametrize("law", ["closed-form", "optimum"])
def test_what_slips_is_felt_no_firmer_than_its_friction(scene, law):
    """Pulled along its axis, clear of the table, which nothing but friction holds."""
    made, closed, placed = scene
    pull, friction = 60.0 * np.asarray(placed.rotation)[:, 2], 0.2 if law == "closed-form" else 0.0
    far = made.table.origin - jnp.array([0.0, 0.0, 1.0])
    drawn = eqx.tree_at(lambda s: (s.friction, s.table.origin, s.gravity), made, (friction, far, jnp.asarray(pull)))
    haptics = Haptics(drawn, MODEL, np.asarray(closed.angles), placed, law, 0.0)
    angles = np.asarray(closed.angles)[list(MODEL.joint_indices(made.hand.joints))]
    for k in range(3):
        tick_law = haptics.tick(k * DT, angles, pose_at(jnp.zeros(3)))
        assert tick_law.is_valid
    instant = haptics.instant
    assert instant.hold == Hold.SLIPPING
    grasp = instant.tick.grasp
    np.testing.assert_allclose(cut_to_cones(grasp, ContactForces(instant.exerted)).forces, instant.exerted, atol=1e-7)
    left = np.asarray(instant.tick.wrench) - np.asarray(resultant(grasp.points, instant.exerted))
    np.testing.assert_allclose(instant.wrench_residual, left, atol=1e-6)
    assert np.linalg.norm(left[:3]) > 1.0


def test_by_the_closed_form_slips_what_the_optimum_holds(scene):
    """The law decides both what is felt and what the object does."""
    rng = np.random.default_rng(0)
    slips = 0
    made, closed, placed = scene
    contacts, grasp, _ = find_touches(made, closed, placed)
    weight = np.append(-made.body.mass * np.asarray(made.gravity), np.zeros(3))
    for _ in range(200):
        wrench = weight + rng.normal(size=6) * (2, 2, 2, 0.02, 0.02, 0.02)
        assessed = monitor(grasp, wrench)
        if not bool(assessed.disagrees):
            continue
        slips += 1
        assert assessed.hold == Hold.SLIPPING
        cut = cut_to_cones(grasp, assessed.exerted).forces
        assert np.linalg.norm(np.asarray(resultant(grasp.points, cut)) - wrench) > 1e-6
        if slips == 3:
            return
    raise AssertionError("no wrench was found on which the laws disagree")


@pytest.mark.parametrize("law", ["closed-form", "optimum"])
@pytest.mark.parametrize("friction, table", [(0.6, 0.5), (0.0, 0.5), (0.0, 0.0)])
def test_the_law_is_valid_whatever_the_hand_holds(scene, law, friction, table):
    """With one finger or all, on a table or above it, forces that balance nothing are felt and have no derivative."""
    made, closed, placed = scene
    made = eqx.tree_at(lambda s: (s.friction, s.table_friction), made, (friction, table))
    angles = np.asarray(closed.angles)[list(MODEL.joint_indices(made.hand.joints))]
    touches = set()
    for bent in (angles * (np.arange(len(angles)) < count) for count in range(0, len(angles) + 1, 2)):
        for up in (0.0, 0.05):
            haptics = Haptics(made, MODEL, np.asarray(closed.angles) * 0.5, placed, law, 0.0)
            for k in range(3):
                tick_law = haptics.tick(k * DT, bent, pose_at(jnp.array([0.0, 0.0, up * k])))
                assert tick_law.is_valid
            touches.add(int(haptics.instant.hold))
    assert Hold.SLIPPING in touches


def test_a_lost_object_is_not_felt(scene):
    made, closed, placed = scene
    haptics = Haptics(made, MODEL, np.zeros(len(made.hand.joints)), placed)
    far = pose_at(jnp.array([0.0, 0.0, 1.0]))
    for k in range(3):
        law = haptics.tick(k * DT, np.zeros(len(MODEL.joints)), far)
    assert law.is_valid and not law.torques.any()


@pytest.mark.parametrize("follows", [False, True])
def test_odd_times_and_readings_spoil_nothing(scene, follows):
    """Times that are none, repeat, run backward or hardly pass: refused, or answered as though nothing had passed."""
    made, closed, placed = scene
    angles = np.asarray(closed.angles)[list(MODEL.joint_indices(made.hand.joints))]

    def played(*odd: tuple) -> np.ndarray:
        haptics = Haptics(made, MODEL, np.asarray(closed.angles), placed, "optimum", 0.02, follows)
        for k in range(8):
            law = haptics.tick(k * DT, angles, pose_at(jnp.zeros(3)))
            assert law.is_valid
            for timestamp, reading, rise in odd if k == 3 else ():
                law = haptics.tick(timestamp, reading, pose_at(jnp.array([0.0, 0.0, rise])))
                assert not law.is_valid or np.abs(law.torques).max() < 1.0
        return law.torques

    plain = played()
    bad = np.where(np.arange(len(angles)) == 3, np.nan, angles)
    for timestamp in (np.nan, np.inf, -np.inf):
        np.testing.assert_array_equal(played((timestamp, angles, 0.0)), plain)
    for timestamp in (3 * DT, -1.0, -100.0, 3 * DT + 1e-9, np.nextafter(3 * DT, 1)):
        np.testing.assert_array_equal(played((timestamp, angles, 1e-3)), plain)
    mad = np.where(np.arange(len(angles)) == 3, 1e300, angles)
    for reading, rise in ((bad, 0.0), (mad, 0.0), (angles + 4, 0.0), (angles, 1e6), (angles, np.nan)):
        np.testing.assert_array_equal(played((3.5 * DT, reading, rise)), plain)


def test_contributions_follow_the_grip_without_a_jump(scene):
    """Held still, they go over to the paper's table; what is rendered is that of the contributions of the instant."""
    made, closed, placed = scene
    plain = eqx.tree_at(lambda s: s.contributions, made, jnp.ones(len(made.hand.links)))
    table = np.asarray(contributions_of(made.hand, GripType.CYLINDRICAL_POWER))
    haptics = Haptics(plain, MODEL, np.asarray(closed.angles), placed, "optimum", 0.0, follows=True)
    angles = np.asarray(closed.angles)[list(MODEL.joint_indices(made.hand.joints))]
    torques, contributions, inertial, poses = [], [], [], []
    for k in range(120):
        torques.append(haptics.tick(k * DT, angles, pose_at(jnp.zeros(3))).torques)
        contributions.append(np.asarray(haptics._state.grip.contributions))
        # Contributions that change move the object a little.
        inertial.append(haptics.inertial)
        poses.append(haptics.placed)
    assert haptics.grip == GripType.CYLINDRICAL_POWER
    apart = np.abs(np.array(contributions) - table).max(1)
    assert apart[0] == apart[int(SETTLING_TIME / DT) - 2] > 0.5 and apart[-1] < 1e-3 and (np.diff(apart) <= 1e-12).all()
    # No tick changes more than its share of what is between the two.
    most = 1 - np.exp(-DT / BLENDING_TIME)
    steps = np.abs(np.diff(np.array(torques)[1:], axis=0)).max(1)
    assert steps.max() <= 1.5 * most * np.abs(torques[-1] - torques[2]).max()
    for k in (1, 30, 119):
        changed_scene = eqx.tree_at(lambda s, k=k: s.contributions, made, contributions[k])
        expected = observe(
            changed_scene, Posture(pose_at(jnp.zeros(3)), closed.angles), poses[k], inertial[k], law="optimum"
        ).torques
        np.testing.assert_allclose(
            -torques[k], np.asarray(expected)[list(MODEL.joint_indices(made.hand.joints))], atol=1e-6
        )


def test_a_grip_that_comes_and_goes_is_no_new_one(scene):
    made, closed, _ = scene
    tables = jnp.asarray(grip_tables(made.hand))
    held, opened = made_contacts(scene, 1.0), made_contacts(scene, 0.0)
    kinds = {int(grip_type(made.hand, closed, contacts)) for contacts in (held, opened)}
    assert len(kinds) == 2
    grip = first_grip(jnp.ones(len(made.hand.links)))
    for k in range(200):
        grip = next_grip(grip, tables, made.hand, closed, held if k % 2 else opened, jnp.asarray(DT))
    np.testing.assert_array_equal(grip.contributions, 1.0)


def made_contacts(scene, share: float):
    """Return the contacts of the hand closed by a share of its angles."""
    made, closed, placed = scene
    return find_touches(made, Posture(closed.wrist, share * jnp.asarray(closed.angles)), placed)[0]
