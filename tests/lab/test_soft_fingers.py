"""Soft fingers: what is rendered balances with the moments about the contacts' normals, and not without them.

Everything expected is computed apart from what renders it, in NumPy: a balance of forces, couples and second
differences of where the object was, the cone of eq. 2 with torsion, and torques as the work of forces and couples as
joints turn.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Body, Hold, Scene, observe, simulate
from jaxgrasp.grip.contact_forces import ContactForces, cut_to_cones
from jaxgrasp.grip.scene_entries import GripEntry, ObjectEntry
from jaxgrasp.grip.scene_file import SceneFile, gripped_scene
from jaxgrasp.hand import Box, Hand, Link, Pose, Posture
from jaxgrasp.lab.haptic_loop import Haptics, pose_at
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import padded
from tests.lab.joint_work import MODEL, by_work

DT, UP, G = 0.01, 3.0, 9.81
MASS, FRICTION, TORSION = 0.1, 0.5, 0.004


OFF, WEAK = 0.006, 1e-4
"""How far beside its middle two fingers hold a box [m]; torsion by which two do not."""


def pinched(torsion: float | None) -> tuple[Scene, Posture, Pose]:
    """Return a box between two balls, off its middle and far above the table: its weight turns it about their line."""
    hand = Hand(
        origins=jnp.zeros((2, 3)),
        rests=jnp.stack([jnp.eye(3)] * 2),
        axes=jnp.array([[1.0, 0.0, 0.0]] * 2),
        lower=jnp.full(2, -1.0),
        upper=jnp.full(2, 1.0),
        skin=padded([(np.zeros((1, 3)), np.array([0.01]))] * 2),
        parents=(-1, -1),
        joints=("left", "right"),
        links=(Link("thumb", "distal", 0), Link("index", "distal", 1)),
        sliding=("left", "right"),
    )
    scene = Scene(
        hand=hand,
        body=Body(Box(0.06, 0.03, 0.03), MASS),
        table=Pose(jnp.array([0.0, 0.0, -1.0]), jnp.eye(3)),
        friction=FRICTION,
        stiffness=4000.0,
        contributions=jnp.ones(2),
        gravity=jnp.array([0.0, 0.0, -G]),
        torsion=torsion,
    )
    posture = Posture(pose_at(jnp.zeros(3)), jnp.array([-0.038, 0.038]))
    return scene, posture, pose_at(jnp.array([0.0, OFF, 0.0]))


@pytest.mark.slow
@pytest.mark.parametrize("law", ["closed-form", "optimum"])
def test_two_soft_fingers_hold_what_hard_ones_let_turn(law):
    """About the line through both contacts only their torsion holds: each takes half of the weight's moment."""
    scene, posture, placed = pinched(TORSION)
    tick = observe(scene, posture, placed, law=law)
    assert tick.assessment.hold == Hold.STABLE
    moments = np.asarray(tick.moments)
    along = moments * np.asarray(tick.grasp.normals)[:, 0]
    np.testing.assert_allclose(along, MASS * G * OFF / 2, rtol=1e-6)
    np.testing.assert_allclose(wrench_of(tick, moments), [0, 0, MASS * G, 0, 0, 0], atol=1e-8)
    assert most_loaded(tick, FRICTION, TORSION) <= 1e-9
    assert observe(pinched(None)[0], posture, placed, law=law).assessment.hold == Hold.SLIPPING


@pytest.mark.slow
@pytest.mark.parametrize("law, right, torsion", [("closed-form", 0.038, WEAK), ("optimum", 0.9, TORSION)])
def test_what_slips_moves_by_what_is_exerted_with_moments(law, right, torsion):
    """Newton and Euler: fingers of little torsion, and by the optimum one finger alone, which holds nothing."""
    scene, posture, placed = pinched(torsion)
    angles = posture.angles.at[1].set(right)
    still = Posture(Pose(jnp.zeros((2, 3)), jnp.stack([jnp.eye(3)] * 2)), jnp.stack([angles] * 2))
    first, second = simulate(scene, still, placed, DT, law=law)
    assert first.hold == Hold.SLIPPING
    forces, moments = np.asarray(first.exerted), np.asarray(first.moments)
    points, normals = np.asarray(first.tick.grasp.points), np.asarray(first.tick.grasp.normals)
    torque = np.cross(points, forces).sum(0) + moments @ normals
    turned = Rotation.from_matrix(np.asarray(second.placed.rotation) @ np.asarray(placed.rotation).T).as_rotvec()
    displacement = np.asarray(second.placed.origin) - np.asarray(placed.origin)
    np.testing.assert_allclose(np.asarray(scene.body.inertia_matrix()) @ turned / DT**2, torque, atol=1e-7)
    np.testing.assert_allclose(MASS * displacement / DT**2, forces.sum(0) - [0, 0, MASS * G], atol=1e-7)
    pressed = np.sum(normals * forces, -1)
    across = np.linalg.norm(forces - pressed[:, None] * normals, axis=-1)
    assert np.all((across / FRICTION) ** 2 + (moments / torsion) ** 2 <= pressed**2 * (1 + 1e-6) + 1e-12)
    assert np.abs(moments).max() > 1e-5 and np.abs(displacement).max() > 1e-6


def wrench_of(tick, moments: np.ndarray) -> np.ndarray:
    """Compute the wrench of the contacts about the object's centre, by the definition."""
    points, normals, forces = (np.asarray(x) for x in (tick.grasp.points, tick.grasp.normals, tick.exerted))
    return np.append(forces.sum(0), np.cross(points, forces).sum(0) + moments @ normals)


def most_loaded(tick, friction: float, torsion: float) -> float:
    """Return the largest |f_t|^2 / mu^2 + m^2 / gamma^2 - (f.a)^2 of all contacts."""
    normals, forces, moments = (np.asarray(x) for x in (tick.grasp.normals, tick.exerted, tick.moments))
    along = np.sum(normals * forces, -1)
    across = np.linalg.norm(forces - along[:, None] * normals, axis=-1)
    assert along.min() >= -1e-9
    return float(np.max((across / friction) ** 2 + (moments / torsion) ** 2 - along**2))


def test_what_a_finger_drags_and_turns_is_cut_alike():
    rng = np.random.default_rng(3)
    points, normals = rng.normal(size=(20, 3)), np.eye(3)[rng.integers(0, 3, 20)]
    forces = 0.2 * rng.normal(size=(20, 3)) + rng.uniform(-0.2, 2.0, size=20)[:, None] * normals
    moments = 0.002 * rng.normal(size=20)
    grasp = Grasp(points, normals, np.full(20, FRICTION), np.ones(20), torsion=np.full(20, TORSION))
    cut = cut_to_cones(grasp, ContactForces(jnp.asarray(forces), jnp.asarray(moments)))
    along = np.maximum(np.sum(normals * forces, -1), 0)
    left = np.asarray(cut.forces) - along[:, None] * normals
    across = forces - np.sum(normals * forces, -1)[:, None] * normals
    share = np.asarray(cut.moments) / moments
    np.testing.assert_allclose(left, share[:, None] * across, atol=1e-12)
    used = np.linalg.norm(left, axis=-1) ** 2 / FRICTION**2 + (np.asarray(cut.moments) / TORSION) ** 2
    np.testing.assert_allclose(used[share < 1], along[share < 1] ** 2, atol=1e-12)
    assert np.all(used <= along**2 + 1e-12) and 0 < (share < 1).sum() < 20 and (share == 0).any()


@pytest.fixture(scope="module")
def soft():
    """Return a scene of a ball with its mass off centre in three soft fingertips."""
    file = SceneFile(
        object=ObjectEntry(
            shape="sphere",
            radius=0.025,
            mass=MASS,
            centre_of_mass=(0.004, 0.008, 0.0),
            friction=FRICTION,
            torsion=TORSION,
            stiffness=4e3,
        ),
        grip=GripEntry(kind="precision-3"),
    )
    return gripped_scene(file)


@pytest.mark.slow
def test_what_is_rendered_balances_with_the_moments(soft):
    """Lifted ever faster: Newton's second law, the soft fingers' cones, the work of the joints, and its slope."""
    made = soft
    haptics = Haptics(made.scene, MODEL, np.asarray(made.closed.angles), made.placed, "optimum", 0.0)
    angles = np.asarray(made.closed.angles)[list(MODEL.joint_indices(made.scene.hand.joints))]
    places, laws = [], []
    for k in range(12):
        laws.append(haptics.tick(k * DT, angles, pose_at(jnp.array([0.0, 0.0, UP * (k * DT) ** 2 / 2]))))
        places.append(np.asarray(haptics.placed.origin))
    instant = haptics.instant
    assert instant.hold == Hold.STABLE and laws[-1].is_valid
    gained = (places[-1] - 2 * places[-2] + places[-3]) / DT**2
    assert gained[2] == pytest.approx(UP, rel=1e-6)
    needed = np.append(MASS * (gained + [0, 0, G]), np.zeros(3))
    moments, tick = np.asarray(instant.moments), instant.tick
    np.testing.assert_allclose(wrench_of(tick, moments), needed, atol=2e-6)
    # The couples are no trifle: without them a balance of torques fails by far more than its rounding.
    assert np.abs(wrench_of(tick, 0 * moments) - needed).max() > 1e-4
    assert most_loaded(tick, FRICTION, TORSION) < 1e-9
    # What was felt last, of the forces and couples that the loop keeps of that tick.
    exerted, touches = haptics._state.exerted, haptics._state.touches
    posture = Posture(pose_at(jnp.array([0.0, 0.0, UP * (11 * DT) ** 2 / 2])), made.closed.angles)
    couples = np.asarray(exerted.moments)[:, None] * np.asarray(touches.grasp.normals)
    points, forces = np.asarray(touches.contacts.points), np.asarray(exerted.forces)
    expected = by_work(made.scene.hand, posture, points, forces, couples)
    np.testing.assert_allclose(laws[-1].torques, expected, atol=1e-8)
    assert np.abs(by_work(made.scene.hand, posture, points, forces, 0 * couples) - expected).max() > 1e-5
    # Between two ticks the line goes along the slope: a tick at once after the last moves nothing.
    for k in range(0, len(angles), 3):
        step = 1e-6 * np.eye(len(angles))[k]
        wrist = posture.wrist
        ahead, back = (haptics.tick(11 * DT, angles + by * step, wrist).torques for by in (1.0, -1.0))
        atol = 2e-5 * np.abs(laws[-1].derivative).max()
        np.testing.assert_allclose(laws[-1].derivative[:, k], (ahead - back) / 2e-6, atol=atol)
