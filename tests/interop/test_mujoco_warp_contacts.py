"""Contacts out of MuJoCo Warp are those that MuJoCo's own engine has in the same states, world by world."""

import contextlib
import importlib
import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.interop import from_mujoco, from_mujoco_warp
from jaxgrasp.model.faults import check_grasp
from jaxgrasp.quality import hold_margin

mujoco = pytest.importorskip("mujoco")
warp = pytest.importorskip("warp", reason="pip install 'jaxgrasp[warp]'")

SCENE = """
<mujoco>
  <option cone="{cone}" impratio="10" gravity="0.5 -1 -9" tolerance="1e-10" iterations="100" jacobian="dense"/>
  <worldbody>
    <geom name="table" type="plane" size="1 1 .1" pos="0 0 -.0299" friction=".4"/>
    <body name="left" pos="-0.048 0 0">
      <joint type="slide" axis="1 0 0" stiffness="400" damping="5"/>
      <geom type="sphere" size=".02" mass=".2" friction="0.6" condim="{condim}"/>
    </body>
    <body name="right" pos="0.048 0.003 0.002">
      <joint type="slide" axis="1 0 0" stiffness="400" damping="5"/>
      <geom type="sphere" size=".02" mass=".2" friction="0.7" condim="{condim}"/>
    </body>
    <body name="object">
      <freejoint/>
      <geom type="sphere" size=".03" mass=".1" friction=".3"/>
      <body pos="0 0.01 0.02"><geom type="sphere" size=".012" mass=".05" friction=".3"/></body>
    </body>
  </worldbody>
</mujoco>
"""
WORLDS = 5


@pytest.fixture(scope="module")
def mjw():
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        warp.config.quiet = True
        warp.init()
        try:
            return importlib.import_module("mujoco_warp")
        except ImportError:
            pytest.skip("mujoco_warp is missing: pip install 'jaxgrasp[warp]'")


def worlds(mjw, cone: str, condim: int):
    """Return a model, the states of MuJoCo, and the same in MuJoCo Warp; the last world touches nothing."""
    model = mujoco.MjModel.from_xml_string(SCENE.format(cone=cone, condim=condim))
    rng = np.random.default_rng(0)
    states = []
    for number in range(WORLDS):
        state = mujoco.MjData(model)
        state.qpos[:2] += [5e-4 * number, -3e-4 * number]
        state.qpos[2:5] += rng.normal(0, 2e-4, 3) + (number == WORLDS - 1)
        state.qvel[:] = 0.05 * rng.normal(size=model.nv)
        state.xfrc_applied[-1] = 0.01 * rng.normal(size=6)
        mujoco.mj_forward(model, state)
        states.append(state)
    with warp.ScopedDevice("cpu"), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        data = mjw.make_data(model, nworld=WORLDS, nconmax=16, njmax=64)
        for name in ("qpos", "qvel", "xfrc_applied"):
            values = np.stack([getattr(state, name) for state in states]).astype(np.float32)
            target = getattr(data, name)
            warp.copy(target, warp.array(values, dtype=target.dtype, device="cpu"))
        mjw.forward(mjw.put_model(model), data)
    return model, states, data


@pytest.mark.slow
@pytest.mark.parametrize(("cone", "condim"), [("elliptic", 3), ("pyramidal", 3), ("pyramidal", 4)])
@pytest.mark.parametrize("choice", [{}, {"hand": ["left", "right"]}, {"exclude": "table"}])
def test_worlds_have_mujocos_contacts(mjw, cone, condim, choice):
    model, states, data = worlds(mjw, cone, condim)
    read = jax.device_get(from_mujoco_warp(model, data, "object", max_contacts=4, **choice))
    assert read.grasp.points.shape == (WORLDS, 4, 3) and (read.dropped == 0).all()
    check_grasp(read.grasp)
    counts = []
    for number, state in enumerate(states):
        expected = from_mujoco(model, state, "object", **choice)
        present = np.flatnonzero(read.grasp.present[number])
        counts.append(len(present))
        assert len(present) == len(expected.links)
        np.testing.assert_allclose(read.wrench[number], expected.wrench, atol=1e-5)
        np.testing.assert_allclose(read.other_wrench[number], expected.other_wrench, atol=2e-3)
        for link, *values in zip(
            expected.links,
            expected.grasp.points,
            expected.grasp.normals,
            expected.grasp.friction,
            expected.grasp.squeeze,
            expected.forces,
            expected.depths,
            strict=True,
        ):
            named = [i for i in present if (model.body(int(read.bodies[number, i])).name or "world") == link]
            place = min(named, key=lambda i: np.linalg.norm(read.grasp.points[number, i] - values[0]))
            got = (
                read.grasp.points[number, place],
                read.grasp.normals[number, place],
                read.grasp.friction[number, place],
                read.grasp.squeeze[number, place],
                read.forces[number, place],
                read.depths[number, place],
            )
            for value, reference, tolerance in zip(got, values, (1e-5, 1e-4, 1e-6, 2e-3, 2e-3, 1e-6), strict=True):
                np.testing.assert_allclose(value, reference, atol=tolerance * max(1, np.abs(expected.forces).max()))
    assert counts[-1] == 0 and max(counts) >= 2
    assert (read.grasp.torsion is not None) == (condim == 4)


@pytest.mark.slow
def test_arrays_are_read_where_they_are(mjw):
    _, _, data = worlds(mjw, "elliptic", 3)
    for array in (data.xipos, data.contact.pos, data.efc.force):
        assert jax.dlpack.from_dlpack(array).unsafe_buffer_pointer() == array.ptr


@pytest.mark.slow
def test_few_places_keep_the_largest_forces(mjw):
    model, _, data = worlds(mjw, "elliptic", 3)
    every = jax.device_get(from_mujoco_warp(model, data, "object", max_contacts=4))
    one = jax.device_get(from_mujoco_warp(model, data, "object", max_contacts=1))
    np.testing.assert_allclose(one.grasp.squeeze[:, 0], every.grasp.squeeze.max(-1), rtol=1e-6)
    np.testing.assert_array_equal(one.dropped, np.maximum(every.grasp.present.sum(-1) - 1, 0))
    margin = np.asarray(hold_margin(every.grasp, every.wrench))
    assert np.isfinite(margin).all() and margin[-1] < -0.99


@pytest.mark.slow
def test_wrong_arguments_are_named(mjw):
    model, states, data = worlds(mjw, "elliptic", 3)
    with pytest.raises(ValueError, match="data is a MjData"):
        from_mujoco_warp(model, states[0], "object")
    with pytest.raises(ValueError, match="max_contacts is 0"):
        from_mujoco_warp(model, data, "object", max_contacts=0)
    with pytest.raises(ValueError, match="hand is 'thumb'"):
        from_mujoco_warp(model, data, "object", hand="thumb")


@pytest.mark.slow
def test_it_runs_inside_jit_on_arrays_of_jax(mjw):
    """MJX's implementation in Warp keeps the same arrays under other names, as JAX's."""
    model, _, data = worlds(mjw, "elliptic", 3)
    expected = from_mujoco_warp(model, data, "object", max_contacts=4)

    class Impl:
        pass

    fields = ("pos", "frame", "dist", "includemargin", "friction", "dim", "geom", "efc_address", "worldid", "type")
    arrays = {f"contact__{name}": jnp.array(jax.dlpack.from_dlpack(getattr(data.contact, name))) for name in fields}
    arrays["nacon"] = jnp.array(jax.dlpack.from_dlpack(data.nacon))
    arrays["efc__force"] = jnp.array(jax.dlpack.from_dlpack(data.efc.force))
    outer = {name: jnp.array(jax.dlpack.from_dlpack(getattr(data, name))) for name in ("xipos", "xfrc_applied")}

    @jax.jit
    def read(arrays, outer):
        state = Impl()
        state._impl = Impl()
        for name, array in arrays.items():
            setattr(state._impl, name, array)
        for name, array in outer.items():
            setattr(state, name, array)
        return from_mujoco_warp(model, state, "object", max_contacts=4)

    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6), read(arrays, outer), expected)
