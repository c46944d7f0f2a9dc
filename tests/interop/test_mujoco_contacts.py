"""Laws of ``from_mujoco``: MuJoCo's own forces balance the wrench that we read off its state."""

import sys

import jaxtyping
import numpy as np
import pytest

from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
from jaxgrasp.model.faults import check_grasp

mujoco = pytest.importorskip("mujoco")

WALLS = """
<mujoco>
  <option timestep="0.001" cone="{cone}" impratio="10" tolerance="1e-14" iterations="200" gravity="0.5 -1 -9"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" friction="0.8" condim="{condim}"/>
    <body name="left" pos="-0.055 0 0.05">
      <joint type="slide" axis="1 0 0" damping="5" stiffness="400"/>
      <geom type="sphere" size=".02" mass=".2" friction="0.6" condim="{condim}"/>
    </body>
    <body pos="0.058 0.01 0.055">
      <joint name="push" type="slide" axis="-1 0 0" damping="5"/>
      <geom type="capsule" size=".02 .01" mass=".2" friction="0.6" condim="{condim}"/>
    </body>
    <body name="object" pos="0 0 0.06" quat="0.99 0.05 0.08 0.02">
      <freejoint/>
      {geoms}
      <body name="knob" pos="0 0.02 0.03">
        <geom name="knob" type="sphere" size=".012" mass=".05" friction=".3" condim="{condim}"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="push"/></actuator>
</mujoco>
"""
GEOMS = (
    '<geom name="block" type="box" size=".03 .025 .02" mass=".3" friction=".3" condim="{condim}"/>',
    '<geom name="foot" type="sphere" pos="0.01 0.01 -0.03" size=".015" mass=".1" friction=".3" condim="{condim}"/>',
)


def build(cone="elliptic", condim=3, geoms=GEOMS):
    text = WALLS.format(cone=cone, condim=condim, geoms="".join(geoms).format(condim=condim))
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def run(model, data, seconds):
    data.ctrl[:] = 4
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(params=["elliptic", "pyramidal"])
def moving(request):
    """Return the object in mid-motion, shoved between a wall that yields and a pusher."""
    model, data = run(*build(request.param), 0.02)
    while len(from_mujoco(model, data, "object").links) < 2 and data.time < 1:
        run(model, data, 0.002)
    assert np.linalg.norm(data.qvel) > 0.05
    return model, data


@pytest.fixture
def resting():
    model, data = run(*build(), 4.0)
    assert np.abs(data.qacc).max() < 0.1
    return model, data


def wrench_of(read: MujocoGrasp) -> np.ndarray:
    return np.concatenate([read.forces.sum(0), np.cross(read.grasp.points, read.forces).sum(0)])


def test_forces_hold_a_resting_body_to_its_acceleration(resting):
    model, data = resting
    read = from_mujoco(model, data, "object")
    assert len(read.links) >= 3
    weight = 0.45 * np.linalg.norm(model.opt.gravity)
    unbalanced = from_mujoco(model, data, "object", accelerating=True).wrench - read.wrench
    np.testing.assert_allclose(wrench_of(read) - read.wrench, unbalanced, atol=1e-9 * weight)
    np.testing.assert_allclose(wrench_of(read)[:3], read.wrench[:3], atol=1e-2 * weight)


def test_forces_balance_the_accelerating_wrench_in_motion(moving):
    read = from_mujoco(*moving, "object", accelerating=True)
    scale = np.abs(read.forces).sum()
    assert scale > 0.1
    np.testing.assert_allclose(wrench_of(read), read.wrench, atol=1e-8 * scale)
    still = from_mujoco(*moving, "object").wrench
    assert np.abs(read.wrench - still).max() > 1e-2


def test_a_spinning_body_without_contacts_needs_nothing():
    model, data = build()
    data.qpos[model.joint(2).qposadr[0] + 2] = 1.0
    data.qvel[-6:] = [0.3, 0.1, 0.2, 7.0, -3.0, 11.0]
    mujoco.mj_forward(model, data)
    read = from_mujoco(model, data, "object", accelerating=True)
    assert read.links == () and read.grasp.points.shape == (0, 3)
    np.testing.assert_allclose(read.wrench, 0, atol=1e-10)


def test_an_applied_wrench_is_one_more_load(moving):
    model, data = moving
    before = from_mujoco(model, data, "object").wrench
    data.xfrc_applied[model.body("object").id] = [1, 2, 3, 0, 0, 0.1]
    offset = data.body("object").xipos - data.subtree_com[model.body("object").id]
    turning = np.cross(offset, [1, 2, 3]) + np.array([0, 0, 0.1])
    expected = -np.array([1, 2, 3, *turning])
    np.testing.assert_allclose(from_mujoco(model, data, "object").wrench - before, expected, atol=1e-12)
    mujoco.mj_forward(model, data)
    read = from_mujoco(model, data, "object", accelerating=True)
    np.testing.assert_allclose(wrench_of(read), read.wrench, atol=1e-8 * np.abs(read.forces).sum())


def test_normals_are_unit_and_point_into_the_object(moving):
    model, data = moving
    read = from_mujoco(model, data, "object")
    check_grasp(read.grasp)
    # The object is convex but for its two bumps: from every contact the normal leads towards its middle.
    bodies = [model.geom(name).id for name in ("block", "foot", "knob")]
    centers = data.geom_xpos[bodies] - data.subtree_com[model.body("object").id]
    for point, normal in zip(read.grasp.points, read.grasp.normals, strict=True):
        assert max((center - point) @ normal for center in centers) > 0


def test_forces_stay_inside_the_cones(moving):
    read = from_mujoco(*moving, "object", squeeze="normal_force")
    pressing = np.einsum("ij,ij->i", read.forces, read.grasp.normals)
    sliding = np.linalg.norm(read.forces - pressing[:, None] * read.grasp.normals, axis=-1)
    assert (sliding <= read.grasp.friction * pressing + 1e-8 * np.abs(read.forces).sum()).all()
    np.testing.assert_allclose(read.grasp.squeeze, pressing, atol=1e-12)


def test_squeeze_is_eq_6_of_the_depth(moving):
    read = from_mujoco(*moving, "object", squeeze="stiffness", stiffness=700.0, contribution=1.5)
    assert (read.depths > 0).any()
    np.testing.assert_allclose(read.grasp.squeeze, 1.5 * 700.0 * read.depths)
    by_link = {link: 100.0 * i for i, link in enumerate(sorted(set(read.links)), 1)}
    read = from_mujoco(*moving, "object", squeeze="stiffness", stiffness=by_link)
    np.testing.assert_allclose(
        read.grasp.squeeze, [by_link[k] * d for k, d in zip(read.links, read.depths, strict=True)]
    )


def test_links_name_what_touches(resting):
    assert set(from_mujoco(*resting, "object").links) <= {"world", "left", "body 2"}


def test_the_other_side_feels_the_opposite(resting):
    model, data = resting
    mine = from_mujoco(model, data, "object")
    with pytest.warns(UserWarning, match="body 'left' hangs on 'world' by 'joint 0'"):
        theirs = from_mujoco(model, data, "left")
    between = np.array([link == "left" for link in mine.links])
    back = np.array([link in ("object", "knob") for link in theirs.links])
    assert between.any()
    np.testing.assert_allclose(mine.forces[between].sum(0), -theirs.forces[back].sum(0), atol=1e-12)


def test_order_of_geoms_does_not_matter():
    reads = []
    for geoms in (GEOMS, GEOMS[::-1]):
        model, data = build(geoms=geoms)
        data.qpos[model.joint(2).qposadr[0] : model.joint(2).qposadr[0] + 3] = [0.0, 0.0, 0.018]
        mujoco.mj_forward(model, data)
        reads.append(from_mujoco(model, data, "object", squeeze="normal_force"))
    assert len(reads[0].links) >= 2
    ours = [sorted(np.column_stack([r.grasp.points, r.grasp.normals, r.forces]).round(7).tolist()) for r in reads]
    np.testing.assert_allclose(ours[0], ours[1], atol=1e-6)
    np.testing.assert_allclose(reads[0].wrench, reads[1].wrench, atol=1e-12)


def test_the_frame_moves_with_the_body():
    reads = []
    for shift in (0.0, 0.4):
        model, data = build()
        data.qpos[model.joint(2).qposadr[0] : model.joint(2).qposadr[0] + 3] = [0.3, shift, 0.04]
        mujoco.mj_forward(model, data)
        reads.append(from_mujoco(model, data, "object"))
    assert reads[0].links
    np.testing.assert_allclose(reads[0].grasp.points, reads[1].grasp.points, atol=1e-12)
    np.testing.assert_allclose(reads[0].wrench, reads[1].wrench, atol=1e-12)
    np.testing.assert_array_equal(reads[0].wrench[:3], -0.45 * model.opt.gravity)


def test_the_state_is_only_read(moving):
    model, data = moving
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    before, after = np.zeros(size), np.zeros(size)
    acceleration = data.cacc.copy()
    mujoco.mj_getState(model, data, before, mujoco.mjtState.mjSTATE_INTEGRATION)
    from_mujoco(model, data, "object", accelerating=True)
    mujoco.mj_getState(model, data, after, mujoco.mjtState.mjSTATE_INTEGRATION)
    np.testing.assert_array_equal(before, after)
    np.testing.assert_array_equal(acceleration, data.cacc)


def test_frictionless_contacts_have_no_friction():
    read = from_mujoco(*run(*build(condim=1), 0.3), "object")
    assert read.links
    np.testing.assert_array_equal(read.grasp.friction, 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"body": "cup"}, "body is 'cup': expected a body of this model, such as left"),
        ({"body": 99}, "body is 99: expected an id from 0 to 4"),
        ({"body": "world"}, "body is 'world', which cannot move"),
        ({"squeeze": "depth"}, "squeeze is 'depth': expected 'stiffness' or 'normal_force'"),
        ({"squeeze": "stiffness", "stiffness": -1.0}, r"stiffness is -1.0: expected a finite number, zero or more"),
        ({"squeeze": "stiffness", "stiffness": float("nan")}, "stiffness is nan"),
        ({"squeeze": "stiffness", "stiffness": {"world": -2.0}}, r"stiffness\['world'\] is -2.0"),
        ({"squeeze": "stiffness", "contribution": {"thumb": 1.0}}, "contribution has no entry for"),
        ({"contribution": "all"}, "contribution is 'all' of type str: expected a number or a Mapping"),
    ],
)
def test_bad_arguments_are_named(resting, monkeypatch, arguments, message):
    # The suite checks types at every call; a user's program does not, and has only our own messages.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises((TypeError, ValueError), match=message):
        from_mujoco(*resting, **{"body": "object"} | arguments)


def test_without_mujoco_one_line_says_what_to_install(monkeypatch, resting):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgrasp\[hands\]'"):
        from_mujoco(*resting, "object")
