"""Soft fingers among several objects: couples about the contacts' normals go to what they touch, by either engine.

A finger that presses on a block and turns about its own normal transmits a moment up to its torsion times its force;
two that pinch a box beside its middle hold it where hard ones let it turn. Everything expected is Newton's, Euler's and
Coulomb's, by the objects' own sizes and motions.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Body, Hold
from jaxgrasp.hand import Hand, Link, Pose, Posture, pose_hand
from jaxgrasp.model.hand import padded
from jaxgrasp.world import HandMove, RigidBody, World, at_rest, simulate_world, stands
from jaxgrasp.world.hand_share import find_touches, hand_share
from jaxgrasp.world.many_bodies import holding_weights
from tests.lab.test_soft_fingers import MASS, OFF, TORSION, pinched
from tests.world.worlds import BLOCK, ENGINES, G, world_with

RADIUS, DEPTH, STIFFNESS, FRICTION, DT = 0.008, 1e-3, 2000.0, 0.5, 2e-3
MASSES = np.array([0.2, 0.3])
EDGES = np.array([BLOCK.length, BLOCK.width, BLOCK.height])
INERTIA = MASSES[:, None] / 12 * (np.sum(EDGES**2) - EDGES**2)
"""Principal moments of the blocks [kg.m^2]."""
EACH_ENGINE = pytest.mark.parametrize("name", ["quasi-static", pytest.param("mujoco", marks=pytest.mark.slow)])


def twister() -> Hand:
    """Return a ball that turns about the vertical through its middle."""
    return Hand(
        origins=jnp.zeros((1, 3)),
        rests=jnp.eye(3)[None],
        axes=jnp.array([[0.0, 0.0, 1.0]]),
        lower=jnp.array([-9.0]),
        upper=jnp.array([9.0]),
        skin=padded([(np.zeros((1, 3)), np.array([RADIUS]))]),
        parents=(-1,),
        joints=("turn",),
        links=(Link("index", "distal", 0),),
    )


def turned(name: str, rate: float, on_top: bool, rubbing: float) -> tuple:
    """Press a finger on a block, rest, then turn ever faster; the other block is below it, or far away.

    Return the world, and for each step the state before it, the contacts of the hand, and the step.
    """
    low, high = BLOCK.height / 2, 1.5 * BLOCK.height
    centers = np.array([[0, 0, high], [0, 0, low]] if on_top else [[0, 0, low], [0.5, 0, low]])
    world, state = world_with(
        [BLOCK, BLOCK],
        centers,
        MASSES.tolist(),
        rubbing=rubbing,
        hand=twister(),
        stiffness=STIFFNESS,
        skin=FRICTION,
        torsion=TORSION,
    )
    engine = ENGINES[name](world, state)
    wrist = Pose(jnp.array([0.0, 0.0, centers[0, 2] + BLOCK.height / 2 + RADIUS - DEPTH]), jnp.eye(3))
    record = []
    for k in range(60):
        before, later = (Posture(wrist, jnp.array([rate * (max(i - 40, 0) * DT) ** 2 / 2])) for i in (k, k + 1))
        touches = find_touches(world, before, state.placed)
        frames = [jax.device_get(pose_hand(world.scene.hand, posture)) for posture in (before, later)]
        step = engine.step(state, HandMove(jax.device_get(touches.contacts), *frames), DT)
        record.append((state, before, touches, step))
        state = step.state
    return world, record


@pytest.mark.slow
@EACH_ENGINE
@pytest.mark.parametrize("rate, slips", [(40.0, False), (160.0, True)])
def test_a_finger_turns_a_block_by_at_most_its_torsion_times_its_force(name, rate, slips):
    """On a table without friction nothing else turns it: I alpha, or gamma N where that is less."""
    world, record = turned(name, rate, False, 0.0)
    inertia, moments, forces = INERTIA[0, 2], [], []
    for state, posture, touches, step in record[45:]:
        force, moment = -step.loads.by_hand[0, 2], step.loads.by_hand[0, 5]
        spin = (step.state.motion.angular - state.motion.angular)[0, 2]
        assert moment == pytest.approx(inertia * spin / DT, rel=1e-3, abs=1e-9)
        assert abs(moment) <= TORSION * force * (1 + 1e-6) + 1e-9
        moments.append(moment)
        forces.append(force)
        wrench = step.left_to_hand(holding_weights(world))
        share = hand_share(world, posture, state.placed, touches, wrench, law="optimum")
        if not slips:
            assert share.assessment.hold[0] == Hold.STABLE
            couple = float(share.moments[0, 0] * share.touches.grasp.normals[0, 0, 2])
            assert couple == pytest.approx(moment, rel=1e-3)
    if name == "quasi-static" or not slips:
        # Springs as eq. 6 has them; what slips hovers by gamma times its way. MuJoCo presses what slips harder.
        np.testing.assert_allclose(forces, STIFFNESS * DEPTH, rtol=0.05)
    expected = TORSION * np.array(forces) if slips else inertia * rate
    np.testing.assert_allclose(moments, expected, rtol={"quasi-static": 1e-5, "mujoco": 0.02}[name])


@EACH_ENGINE
def test_momenta_of_every_object_change_by_its_forces_and_couples(name):
    """Newton and Euler: the upper block is turned by the finger, and the lower one and the table rub against it."""
    _, record = turned(name, 160.0, True, 0.05)
    couples = []
    for state, _, _, step in record[42:]:
        loads, after = step.loads, step.state
        total = loads.by_world + loads.by_hand
        gained = MASSES[:, None] * ((after.motion.linear - state.motion.linear) / DT + [0, 0, G])
        spun = INERTIA * (after.motion.angular - state.motion.angular) / DT
        np.testing.assert_allclose(total[:, :3], gained, atol=1e-5)
        np.testing.assert_allclose(total[:, 3:], spun, atol=1e-5)
        np.testing.assert_allclose(loads.by_bodies[0, 1, 5], -loads.by_bodies[1, 0, 5], atol=1e-8)
        assert not loads.by_hand[1].any()
        couples.append(loads.by_hand[0, 5])
    # The finger's couple is no trifle beside what is tested.
    assert np.min(np.abs(couples[4:])) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ENGINES)
def test_two_soft_fingers_hold_among_others_what_hard_ones_let_turn(name):
    """About the line through both contacts soft fingers take the weight's moment, by both engines."""
    times = np.arange(30)
    angles = []
    for torsion in (TORSION, None):
        scene, posture, placed = pinched(torsion)
        block = RigidBody(Body(BLOCK, 0.2), 0.5, 4000.0, 0.5, 0.002)
        world = World(scene, (block,))
        origin = np.stack([np.asarray(placed.origin), [0.0, 0.0, -1 + BLOCK.height / 2]])
        state = at_rest(Pose(origin, np.stack([np.eye(3)] * 2)))
        wrists = Pose(jnp.zeros((len(times), 3)), jnp.stack([jnp.eye(3)] * len(times)))
        postures = Posture(wrists, jnp.stack([posture.angles] * len(times)))
        record = simulate_world(world, ENGINES[name](world, state), postures, state, 0.01, law="optimum")
        last = record[-1]
        angles.append(np.linalg.norm(Rotation.from_matrix(last.state.placed.rotation[0]).as_rotvec()))
        if torsion is None:
            continue
        assert last.gripped.hold == Hold.STABLE and last.share.assessment.hold[1] == Hold.LOST
        np.testing.assert_allclose(last.loads.by_hand[0], [0, 0, MASS * G, 0, 0, 0], atol=2e-3 * MASS * G)
        grasp, by_hand = last.share.touches.grasp, last.share.by_hand
        points, normals, forces, moments = (np.asarray(part)[0] for part in (grasp.points, grasp.normals, *by_hand))
        torque = np.cross(points, forces).sum(0) + moments @ normals
        np.testing.assert_allclose(torque, last.gained[0, 3:], atol=1e-7)
        along = moments * normals[:, 0]
        assert along.sum() == pytest.approx(MASS * G * OFF, rel=0.02)
        # MuJoCo's box creeps towards one of the fingers, which then presses harder, and takes more.
        if name == "quasi-static":
            np.testing.assert_allclose(along, MASS * G * OFF / 2, rtol=1e-3)
    held, let_go = angles
    assert held < 0.01 and let_go > 0.3


def test_moments_of_soft_fingers_are_part_of_what_stands():
    """The same pinch as one balance of forces and couples: by its moments alone, each half of the weight's."""
    standing = []
    for torsion in (TORSION, None):
        scene, posture, placed = pinched(torsion)
        world = World(scene, ())
        poses = Pose(np.asarray(placed.origin)[None], np.eye(3)[None])
        contacts = jax.device_get(find_touches(world, posture, poses).contacts)
        standing_result = stands(world, poses, contacts)
        assert standing_result.proved
        standing.append(standing_result.stands)
        if standing_result.stands:
            along = standing_result.moments * standing_result.contacts.normals[:, 0]
            np.testing.assert_allclose(along, MASS * G * OFF / 2, rtol=1e-6)
            pressed = np.einsum("mi,mi->m", standing_result.forces, standing_result.contacts.normals)
            across = np.linalg.norm(
                standing_result.forces - pressed[:, None] * standing_result.contacts.normals, axis=1
            )
            used = (across / standing_result.contacts.friction) ** 2 + (standing_result.moments / TORSION) ** 2
            assert np.all(used <= pressed**2 * (1 + 1e-9))
            np.testing.assert_allclose(standing_result.residual, 0, atol=1e-9)
    assert standing == [True, False]
