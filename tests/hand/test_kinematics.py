"""A posed hand: against MuJoCo's kinematics of the same tree, autodiff, and the work that forces do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.hand import Pose, Posture, human_hand, pose_hand
from tests.hand.hands import random_posture

HAND = human_hand()
COUNT = 50


def mujoco_twin(hand):
    """Build the same hand as a MuJoCo model: one body to a hinge, one site at each link's third sphere."""
    import mujoco

    spec = mujoco.MjSpec()
    wrist = spec.worldbody.add_body(name="wrist")
    wrist.add_freejoint()
    ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [0.01, 0, 0]}
    wrist.add_geom(**ball)
    bodies = []
    for j, parent in enumerate(hand.parents):
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.asarray(hand.rests[j]).ravel())
        carrier = wrist if parent < 0 else bodies[parent]
        bodies.append(carrier.add_body(pos=np.asarray(hand.origins[j]), quat=quat))
        bodies[-1].add_joint(name=hand.joints[j], axis=np.asarray(hand.axes[j]), type=mujoco.mjtJoint.mjJNT_HINGE)
        bodies[-1].add_geom(**ball)
    for i, link in enumerate(hand.links):
        carrier = wrist if link.joint < 0 else bodies[link.joint]
        carrier.add_site(name=link.name, pos=np.asarray(hand.skin.centers[i, 3]))
    return spec.compile()


def places(frames) -> jax.Array:
    """Return the centre of each link's third sphere in the world."""
    return frames.links.origin + jnp.einsum("...lij,lj->...li", frames.links.rotation, HAND.skin.centers[:, 3])


@pytest.mark.parametrize("side", ["right", "left"])
def test_places_and_jacobians_are_mujocos(side):
    mujoco = pytest.importorskip("mujoco")
    hand = human_hand(side=side)
    model = mujoco_twin(hand)
    data = mujoco.MjData(model)
    posture = random_posture(hand, COUNT)
    frames = pose_hand(hand, posture)
    local = hand.skin.centers[:, 3]
    got = frames.links.origin + jnp.einsum("...lij,lj->...li", frames.links.rotation, local)
    jacobian = jaxgrasp.hand.contact_jacobian(hand, frames, got)
    for i in range(COUNT):
        data.qpos[:3] = posture.wrist.origin[i]
        mujoco.mju_mat2Quat(data.qpos[3:7], np.asarray(posture.wrist.rotation[i]).ravel())
        data.qpos[7:] = posture.angles[i]
        mujoco.mj_forward(model, data)
        for k, link in enumerate(hand.links):
            site = model.site(link.name).id
            np.testing.assert_allclose(got[i, k], data.site_xpos[site], atol=1e-12)
            expected = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, expected, None, site)
            np.testing.assert_allclose(jacobian[i, k], expected[:, 6:], atol=1e-12)


def test_the_jacobian_is_that_of_autodiff():
    posture = random_posture(HAND, COUNT)
    frames = pose_hand(HAND, posture)
    closed = jaxgrasp.hand.contact_jacobian(HAND, frames, places(frames))
    by_autodiff = jax.vmap(jax.jacobian(lambda a, w: places(pose_hand(HAND, Posture(w, a)))))(
        posture.angles, posture.wrist
    )
    np.testing.assert_allclose(closed, by_autodiff, atol=1e-14)


def test_torques_do_the_work_of_the_forces():
    """Virtual work: torque . angle rate = (-f) . velocity of its point."""
    posture = random_posture(HAND, COUNT)
    frames = pose_hand(HAND, posture)
    forces = np.random.default_rng(3).normal(size=(COUNT, len(HAND.links), 3))
    torques = jaxgrasp.hand.joint_torques(HAND, frames, places(frames), forces)
    jacobian = jaxgrasp.hand.contact_jacobian(HAND, frames, places(frames))
    np.testing.assert_allclose(torques, np.einsum("blcj,blc->bj", jacobian, -forces), atol=1e-13)


def test_a_finger_that_presses_feels_its_flexion_resisted():
    """Straight fingers press towards the palm's side: what they feel would bend them back."""
    frames = pose_hand(HAND, Posture(Pose(np.zeros(3), np.eye(3)), np.zeros(19)))
    press = np.zeros((len(HAND.links), 3))
    tips = [i for i, link in enumerate(HAND.links) if link.phalanx == "distal" and link.finger != "thumb"]
    press[tips, 2] = -1.0
    torques = jaxgrasp.hand.joint_torques(HAND, frames, places(frames), press)
    flexions = [j for j, name in enumerate(HAND.joints) if name.split()[1] != "abduction" and "thumb" not in name]
    assert (torques[np.array(flexions)] < -0.001).all()
    index_mp = HAND.joints.index("index MP")
    arm = places(frames)[[link.name for link in HAND.links].index("index distal")]
    assert float(torques[index_mp]) == pytest.approx(-float(arm[0] - 0.447 * 0.19), rel=1e-12)


def test_frames_turn_and_move_with_the_wrist():
    still = random_posture(HAND, COUNT)
    resting = Posture(Pose(jnp.zeros((COUNT, 3)), jnp.broadcast_to(jnp.eye(3), (COUNT, 3, 3))), still.angles)
    frames, at_rest = pose_hand(HAND, still), pose_hand(HAND, resting)
    turned = jnp.einsum("bij,bkj->bki", still.wrist.rotation, at_rest.links.origin)
    np.testing.assert_allclose(frames.links.origin, turned + still.wrist.origin[:, None], atol=1e-15)
    np.testing.assert_allclose(
        frames.links.rotation, jnp.einsum("bij,bkjl->bkil", still.wrist.rotation, at_rest.links.rotation), atol=1e-15
    )


def test_leading_axes_broadcast():
    posture = random_posture(HAND, 6)
    angles = posture.angles.reshape(2, 3, -1)
    one_wrist = Posture(Pose(posture.wrist.origin[0], posture.wrist.rotation[0]), angles)
    frames = pose_hand(HAND, one_wrist)
    assert frames.links.origin.shape == (2, 3, 19, 3) and frames.joints.rotation.shape == (2, 3, 19, 3, 3)
    alone = pose_hand(HAND, Posture(one_wrist.wrist, angles[1, 2]))
    np.testing.assert_allclose(frames.links.origin[1, 2], alone.links.origin, atol=1e-16)


def test_a_wrong_number_of_angles_is_named():
    with pytest.raises(ValueError, match=r"angles has shape \(18,\): expected \(..., 19\)"):
        pose_hand(HAND, Posture(Pose(np.zeros(3), np.eye(3)), np.zeros(18)))
