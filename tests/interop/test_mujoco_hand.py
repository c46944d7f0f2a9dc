"""Hands out of MuJoCo models: their kinematics are MuJoCo's own, and so are the places of their spheres."""

import importlib.util
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.hand import Pose, Posture, pose_hand
from jaxgrasp.interop import hand_from_mujoco, hand_from_urdf

mujoco = pytest.importorskip("mujoco")
COUNT = 1000
OPPOSED = -0.25


def allegro() -> Path:
    """Return the path of the Allegro hand's URDF, or skip the test."""
    try:
        paths = files("example-robot-data") or []
    except PackageNotFoundError:
        pytest.skip("needs example-robot-data")
    (path,) = [file.locate() for file in paths if file.name == "allegro_right_hand.urdf"]
    return Path(path)


def model_of(name: str):
    """Return a model, its wrist's body and its locked joints."""
    if name == "myohand":
        compose = pytest.importorskip("myo_sim.build.compose")
        return compose.build_right_hand_from_arm_spec().compile(), None, {"cmc_flexion_r": OPPOSED}
    if name == "allegro":
        return hand_from_urdf(allegro(), "palm_link").model, "palm_link", {}
    spec = importlib.util.find_spec("gymnasium_robotics")
    if spec is None:
        pytest.skip("needs gymnasium-robotics")
    assets = Path(spec.origin).parent / "envs" / "assets"
    path = {"shadow": assets / "hand" / "reach.xml", "adroit": assets / "adroit_hand" / "adroit_relocate.xml"}[name]
    wrist = {"shadow": "robot0:palm", "adroit": "palm"}[name]
    return mujoco.MjModel.from_xml_path(str(path)), wrist, {}


def wrist_of(model, wrist: str | None) -> str:
    """Return the deepest body that carries every hinge named after a finger."""
    if wrist is not None:
        return wrist
    return model.body(int(model.body_parentid[model.body("secondmc_r").id])).name


@pytest.fixture(scope="module", params=["myohand", "shadow", "adroit", "allegro"])
def case(request):
    model, wrist, locked = model_of(request.param)
    wrist = wrist_of(model, wrist)
    return request.param, model, wrist, locked, hand_from_mujoco(model, wrist, locked=locked)


def random_angles(hand, count: int) -> np.ndarray:
    lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
    return lower + np.random.default_rng(1).uniform(size=(count, len(lower))) * (upper - lower)


def states(model, wrist: str, locked: dict, hand, angles: np.ndarray):
    """Yield MuJoCo's states at these angles, everything else at rest, and the wrist's pose in each."""
    data = mujoco.MjData(model)
    body = model.body(wrist).id
    for row in angles:
        data.qpos[:] = model.qpos0
        data.qpos[hand.addresses] = row
        for name, value in locked.items():
            data.qpos[model.joint(name).qposadr] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        yield data, Pose(data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy())


def test_bodies_and_jacobians_are_mujocos(case):
    _, model, wrist, locked, converted = case
    hand = converted.hand
    angles = random_angles(hand, COUNT)
    places, turns, wrists, jacobians = [], [], [], []
    for data, pose in states(model, wrist, locked, converted, angles):
        places.append(data.xpos[converted.bodies].copy())
        turns.append(data.xmat[converted.bodies].reshape(-1, 3, 3).copy())
        wrists.append(pose)
        jacobians.append([])
        for body in converted.bodies:
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacBody(model, data, jacobian, None, body)
            jacobians[-1].append(jacobian[:, converted.velocities])
    wrist_pose = jax.tree.map(lambda *parts: np.stack(parts), *wrists)
    frames = pose_hand(hand, Posture(wrist_pose, angles))
    at = np.asarray(frames.links.origin) + np.einsum("blij,lj->bli", frames.links.rotation, converted.positions)
    np.testing.assert_allclose(at, places, atol=1e-9)
    np.testing.assert_allclose(frames.links.rotation @ converted.rotations, turns, atol=1e-9)
    np.testing.assert_allclose(jaxgrasp.hand.contact_jacobian(hand, frames, at), jacobians, atol=1e-7)


def test_it_has_the_joints_that_were_asked_for(case):
    name, model, _, locked, converted = case
    hand = converted.hand
    assert not set(hand.joints) & set(locked)
    if name == "myohand":
        # With its thumb's flexion at the wrist locked it has the glove's joints.
        kinds = ["abduction" in joint for joint in hand.joints]
        assert len(kinds) == 19 and sum(kinds) == 5
    limited = model.jnt_limited[[model.joint(joint).id for joint in hand.joints]].astype(bool)
    assert (np.asarray(hand.lower)[limited] < np.asarray(hand.upper)[limited]).all()


def test_only_meshes_are_left_out(case):
    _, model, _, _, hand = case
    by_name = {model.geom(g).name or f"geom {g}": g for g in range(model.ngeom)}
    kinds = {int(model.geom_type[by_name[name]]) for name in hand.left_out}
    assert kinds <= {int(mujoco.mjtGeom.mjGEOM_MESH)}


def outside(model, geom: int, at: np.ndarray) -> np.ndarray:
    """Return how far points in a geom's frame lie outside its surface, by its definition: at most 0 inside."""
    kinds, size = mujoco.mjtGeom, model.geom_size[geom]
    across = np.hypot(at[:, 0], at[:, 1])
    kind = model.geom_type[geom]
    if kind == kinds.mjGEOM_SPHERE:
        return np.linalg.norm(at, axis=1) - size[0]
    if kind == kinds.mjGEOM_CAPSULE:
        return np.hypot(across, np.maximum(np.abs(at[:, 2]) - size[1], 0)) - size[0]
    if kind == kinds.mjGEOM_CYLINDER:
        return np.maximum(across - size[0], np.abs(at[:, 2]) - size[1])
    if kind == kinds.mjGEOM_BOX:
        return (np.abs(at) - size).max(1)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return size.min() * (np.linalg.norm(at / size, axis=1) - 1)
    return np.full(len(at), np.inf)


def test_spheres_lie_inside_their_geoms(case):
    """Every point on every sphere is inside one of its body's geoms, and every geom holds a sphere."""
    _, model, wrist, locked, converted = case
    hand = converted.hand
    angles = random_angles(hand, 1)
    data, pose = next(states(model, wrist, locked, converted, angles))
    frames = jax.device_get(pose_hand(hand, Posture(pose, angles[0])))
    ball = np.random.default_rng(2).normal(size=(60, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    for k, body in enumerate(converted.bodies):
        first, count = model.body_geomadr[body], model.body_geomnum[body]
        geoms = [g for g in range(first, first + count) if model.geom_contype[g] or model.geom_conaffinity[g]]
        used = set()
        for center, radius in zip(hand.skin.centers[k], hand.skin.radii[k], strict=True):
            if radius == 0:
                continue
            points = (np.asarray(center) + float(radius) * ball) @ frames.links.rotation[k].T + frames.links.origin[k]
            local = [(points - data.geom_xpos[g]) @ data.geom_xmat[g].reshape(3, 3) for g in geoms]
            beyond = np.array([outside(model, g, at).max() for g, at in zip(geoms, local, strict=True)])
            assert beyond.min() < 1e-9
            used |= {geoms[i] for i in np.flatnonzero(beyond < 1e-9)}
        assert used >= {g for g in geoms if (model.geom(g).name or f"geom {g}") not in converted.left_out}


def test_a_wide_palm_is_covered_to_its_edges():
    """Spheres cover a box to its edges: no point of its middle plane is far from a sphere."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="palm"><geom type="box" size="0.04 0.01 0.05"/>
        <body><joint type="hinge"/><geom type="box" size="0.008 0.008 0.02"/></body></body></worldbody></mujoco>"""
    )
    hand = hand_from_mujoco(model, "palm").hand
    centers, radii = np.asarray(hand.skin.centers), np.asarray(hand.skin.radii)
    x, z = np.meshgrid(np.linspace(-0.039, 0.039, 40), np.linspace(-0.049, 0.049, 40))
    plane = np.stack([x, 0 * x, z], -1).reshape(-1, 1, 3)
    depth = radii[0] - np.linalg.norm(plane - centers[0], axis=-1)
    # But for the corners themselves.
    assert np.quantile(depth.max(1), 0.02) > 0 and depth.max(1).min() > -0.005
    assert (radii[1] > 0).sum() == 12


def test_names_that_the_model_lacks_are_refused(case):
    _, model, wrist, _, _ = case
    with pytest.raises(ValueError, match="wrist is 'elbow': the model has no body of that name"):
        hand_from_mujoco(model, "elbow")
    with pytest.raises(ValueError, match="locked names 'none': the model has no joint"):
        hand_from_mujoco(model, wrist, locked={"none": 0.0})


def drawer(*kinds) -> mujoco.MjModel:
    """Return bodies that hang on each other, each by a joint off its middle and off the axes."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="wrist")
    for i, kind in enumerate(kinds):
        body = body.add_body(name=f"body {i}", pos=[0.1, 0.02 * i, 0], quat=[1, 0.2 * i, 0.3, 0])
        body.add_joint(name=f"joint {i}", type=kind, axis=[1, 0.5, i], pos=[0.01, 0, 0.02], ref=0.05)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.01, 0.02, 0])
    return spec.compile()


HINGE, SLIDE, BALL = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL


def test_what_slides_in_mujoco_slides_here():
    model = drawer(SLIDE, HINGE, SLIDE, HINGE)
    hand = hand_from_mujoco(model, "wrist")
    assert hand.hand.sliding == ("joint 0", "joint 2")
    angles = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 4))
    for row, (data, wrist) in zip(angles, states(model, "wrist", {}, hand, angles), strict=True):
        frames = pose_hand(hand.hand, Posture(wrist, row))
        at = np.asarray(frames.links.origin) + np.einsum("lij,lj->li", frames.links.rotation, hand.positions)
        np.testing.assert_allclose(at, data.xpos[hand.bodies], atol=1e-12)
        jacobian = jaxgrasp.hand.contact_jacobian(hand.hand, frames, at)
        for link, body in enumerate(hand.bodies):
            expected = np.zeros((3, model.nv))
            mujoco.mj_jacBody(model, data, expected, None, body)
            np.testing.assert_allclose(jacobian[link], expected[:, hand.velocities], atol=1e-12)


def test_a_locked_slide_stays_where_it_was_put():
    model = drawer(SLIDE, HINGE)
    hand = hand_from_mujoco(model, "wrist", locked={"joint 0": 0.3})
    assert hand.hand.joints == ("joint 1",) and [link.name for link in hand.hand.links] == ["body 0", "body 1"]
    angles = np.array([[0.2]])
    ((data, wrist),) = states(model, "wrist", {"joint 0": 0.3}, hand, angles)
    frames = pose_hand(hand.hand, Posture(wrist, angles[0]))
    at = np.asarray(frames.links.origin) + np.einsum("lij,lj->li", frames.links.rotation, hand.positions)
    np.testing.assert_allclose(at, data.xpos[hand.bodies], atol=1e-12)


def test_what_neither_turns_nor_slides_is_refused():
    with pytest.raises(ValueError, match="joint 'joint 0' neither turns about an axis nor slides"):
        hand_from_mujoco(drawer(BALL), "wrist")
    with pytest.raises(ValueError, match="no joint, or no geom that can touch"):
        hand_from_mujoco(drawer(SLIDE), "wrist", locked={"joint 0": 0.3})
