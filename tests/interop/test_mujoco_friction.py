"""Laws of MuJoCo's contact dimensions: its forces and moments lie in a Grasp's cones and balance the object."""

import contextlib
import io
import warnings

import jax
import numpy as np
import pytest

from jaxgrasp.interop import from_mjx, from_mujoco

mujoco = pytest.importorskip("mujoco")
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    mjx = pytest.importorskip("mujoco.mjx")

HELD = """
<mujoco>
  <option cone="{cone}" impratio="10" tolerance="1e-14" iterations="100" jacobian="dense"/>
  <worldbody>
    <body name="left" pos="-0.048 0 0">
      <joint type="slide" axis="1 0 0" stiffness="400" damping="5"/>
      <geom name="pad" type="sphere" size=".02" mass=".2" friction="0.6 0.02 0.003" condim="{condim}"/>
    </body>
    <body name="right" pos="0.048 0.003 0.002">
      <joint type="slide" axis="1 0 0" stiffness="400" damping="5"/>
      <geom name="nail" type="sphere" size=".02" mass=".2" friction="0.7 0.03 0.004" condim="{other}"/>
    </body>
    <body name="object"><freejoint/>
      <geom name="ball" type="sphere" size=".03" mass=".1" condim="1" friction=".3"/>
    </body>
  </worldbody>
  <contact>{contact}</contact>
</mujoco>
"""
DIMS = (1, 3, 4, 6)
TORSION = {"left": 0.02, "right": 0.03}


def held(cone="elliptic", condim=3, other_condim=None, contact=""):
    """Return a ball in mid-motion, turning between two pads that yield."""
    text = HELD.format(cone=cone, condim=condim, other=other_condim or condim, contact=contact)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[2:] = [0.02, -0.01, 0.03, 4.0, 1.0, -2.0]
    mujoco.mj_forward(model, data)
    return model, data


def read_with_warnings(read, *arguments, **options):
    """Return what a reader returns, and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = read(*arguments, **options)
    return result, [str(warning.message) for warning in caught]


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("dims", [(1, 1), (3, 3), (4, 4), (6, 6), (3, 4), (1, 4), (4, 6)], ids=str)
def test_forces_and_moments_lie_in_the_cones_and_balance_the_object(cone, dims):
    model, data = held(cone, *dims)
    read, warned = read_with_warnings(from_mujoco, model, data, "object", accelerating=True)
    assert read.links == ("left", "right")
    grasp, (forces, moments) = read.grasp, (read.forces, read.moments)
    scale = np.abs(forces).sum()
    torques = np.cross(grasp.points, forces) + moments
    np.testing.assert_allclose([*forces.sum(0), *torques.sum(0)], read.wrench, atol=1e-8 * scale)
    by_link = {"left": dims[0], "right": dims[1]}
    expected = [TORSION[link] * (by_link[link] >= 4) for link in read.links]
    if max(dims) < 4:
        assert grasp.torsion is None
    else:
        np.testing.assert_allclose(grasp.torsion, expected)
    pressing = np.einsum("ij,ij->i", forces, grasp.normals)
    sliding = np.linalg.norm(forces - pressing[:, None] * grasp.normals, axis=-1)
    spinning = np.abs(np.einsum("ij,ij->i", moments, grasp.normals))
    np.testing.assert_array_equal(grasp.friction == 0, np.array(dims) == 1)
    used = (sliding / np.maximum(grasp.friction, 1e-9)) ** 2 + (spinning / np.maximum(expected, 1e-9)) ** 2
    assert (used <= (pressing * (1 + 1e-6)) ** 2 + 1e-12).all()
    # The ball spins: torsional friction works at its limit.
    assert (spinning[np.array(dims) >= 4] > 1e-4).all() and pressing.min() > 0.1
    # Moments across the normal are rolling friction, which is named; in a pyramid spinning leaves it no room.
    along = np.einsum("ij,ij->i", moments, grasp.normals)
    rolling = np.linalg.norm(moments - along[:, None] * grasp.normals, axis=-1)
    np.testing.assert_array_equal(rolling > 1e-9, np.array(dims) == (6 if cone == "elliptic" else 0))
    names = ", ".join(repr(link) for link in read.links if by_link[link] == 6)
    assert [text.split(" is left out")[0] for text in warned] == (
        [f"rolling friction (condim 6) of the contacts with {names}"] if names else []
    )


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("dims", [(4, 4), (6, 3)], ids=str)
def test_mjx_reads_the_same_torsion_moments_and_warnings(cone, dims):
    model, data = held(cone, *dims)
    state, warned = read_with_warnings(from_mujoco, model, data, "object")
    read, also = read_with_warnings(from_mjx, mjx.put_model(model), mjx.put_data(model, data), "object")
    assert also == warned
    read = jax.device_get(read)
    present = read.grasp.present > 0
    order = np.argsort(read.bodies[present])
    assert [model.body(int(i)).name for i in read.bodies[present][order]] == list(state.links)
    np.testing.assert_allclose(read.moments[present][order], state.moments, atol=1e-12)
    np.testing.assert_allclose(read.grasp.torsion[present][order], state.grasp.torsion, atol=1e-12)
    assert not read.grasp.torsion[~present].any() and not read.moments[~present].any()
    deepest = from_mjx(mjx.put_model(model), mjx.put_data(model, data), "object", hand="right", max_contacts=1)
    (index,) = np.flatnonzero(np.array(state.links) == "right")
    np.testing.assert_allclose(deepest.grasp.torsion, state.grasp.torsion[[index]], atol=1e-12)


def test_a_model_without_torsional_friction_has_none_in_mjx():
    model, data = held(condim=3)
    assert from_mjx(mjx.put_model(model), mjx.put_data(model, data), "object").grasp.torsion is None


PAIR = '<pair geom1="ball" geom2="pad" condim="{}" friction="0.9 0.4 0.01 0.001 0.001"/>'


def test_of_two_sliding_coefficients_the_smaller_is_taken_and_told():
    model, data = held(contact=PAIR.format(4))
    expected = ["two sliding coefficients of the contacts with 'left' differ: the smaller is taken for both directions"]
    state, warned = read_with_warnings(from_mujoco, model, data, "object")
    read, also = read_with_warnings(from_mjx, mjx.put_model(model), mjx.put_data(model, data), "object")
    assert warned == also == expected
    assert dict(zip(state.links, state.grasp.friction, strict=True)) == {"left": 0.4, "right": 0.7}
    assert sorted(np.asarray(read.grasp.friction)[np.asarray(read.grasp.present) > 0]) == [0.4, 0.7]


def test_mjx_names_rolling_friction_only_of_geoms_that_can_touch_and_count():
    left = "rolling friction (condim 6) of the contacts with 'left'"

    def warned(condim=6, other_condim=3, contact="", **options):
        model, data = held(condim=condim, other_condim=other_condim, contact=contact)
        _, texts = read_with_warnings(from_mjx, mjx.put_model(model), mjx.put_data(model, data), "object", **options)
        return [text.split(" is left out")[0] for text in texts]

    assert warned() == [left]
    assert warned(hand="right") == warned(exclude="left") == []
    assert warned(contact=PAIR.format(3).replace("0.9", "0.4")) == []
    assert warned(3, contact=PAIR.format(6).replace("0.9", "0.4")) == [left]
    assert warned(contact='<exclude body1="left" body2="object"/>', other_condim=6) == [left.replace("left", "right")]


@pytest.mark.parametrize("margin", [0.0, 0.002])
def test_contacts_within_a_gap_do_not_count_and_those_within_a_margin_do(margin):
    text = f"""<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
      <body name="object" pos="0 0 .031"><freejoint/>
        <geom type="sphere" size=".03" mass=".3" margin="{margin}" gap="0.01"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    read = from_mujoco(model, data, "object")
    in_mjx = from_mjx(mjx.put_model(model), mjx.put_data(model, data), "object")
    assert len(read.links) == int(in_mjx.grasp.present.sum()) == (margin > 0)
    np.testing.assert_allclose(read.depths, [0.001] * (margin > 0), atol=1e-12)


def test_adhesion_is_named_once_and_forces_are_net_of_it():
    text = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1" adhesion="5"/>
      <body name="object" pos="0 0 .03"><freejoint/><geom type="box" size=".03 .03 .03" mass=".3"/></body></worldbody>
      </mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    mujoco.mj_forward(model, data)
    read, warned = read_with_warnings(from_mujoco, model, data, "object")
    assert warned == ["adhesion of the contacts with 'world' is left out: a Grasp's contacts do not pull"]
    np.testing.assert_allclose(read.forces.sum(0), read.wrench[:3], atol=1e-4)
