"""Contacts out of MJX are those that MuJoCo's own engine has in the same state, one by one, jitted and mapped."""

import contextlib
import importlib.util
import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from benchmarks.contact_sets import close
from jaxgrasp.interop import from_mjx, from_mujoco
from jaxgrasp.model.faults import check_grasp

mujoco = pytest.importorskip("mujoco")
# It says on import which of its engines are missing.
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    mjx = pytest.importorskip("mujoco.mjx")

HELD = """
<mujoco>
  <option cone="{cone}" impratio="10" gravity="0.5 -1 -9" tolerance="1e-14" iterations="100" ls_iterations="50"
    jacobian="dense"/>
  <worldbody>
    <body name="left" pos="-0.048 0 0">
      <joint type="slide" axis="1 0 0" stiffness="400" damping="5"/>
      <geom type="sphere" size=".02" mass=".2" friction="0.6" condim="{condim}"/>
    </body>
    <body name="right" pos="0.048 0.003 0.002">
      <joint type="slide" axis="1 0 0" stiffness="400" damping="5"/>
      <geom type="capsule" size=".02 .01" mass=".2" friction="0.7" condim="{condim}"/>
    </body>
    <body name="far" pos="1 0 0"><geom type="sphere" size=".02" condim="{condim}"/></body>
    <body name="object">
      <freejoint/>
      <geom type="sphere" size=".03" mass=".1" friction=".3" condim="{condim}"/>
      <body pos="0 0.01 0.02"><geom type="sphere" size=".012" mass=".05" friction=".3" condim="{condim}"/></body>
    </body>
  </worldbody>
</mujoco>
"""


CAPSULES = 5e-5
"""MJX adds 1e-6 to the square of a capsule's length as it looks for the nearest point: of these, which are 20 mm long
and more, that moves it by as much [m]."""


def held(cone: str = "elliptic", condim: int = 3):
    """Return an object in mid-motion between two balls that yield."""
    model = mujoco.MjModel.from_xml_string(HELD.format(cone=cone, condim=condim))
    data = mujoco.MjData(model)
    data.qvel[2:] = np.random.default_rng(0).normal(size=model.nv - 2)[: model.nv - 2] * 0.05
    mujoco.mj_forward(model, data)
    return model, data


def matched(read, state, model):
    """Return MJX's present contacts in the order of MuJoCo's: by the touching body and the nearest point."""
    read_state = jax.device_get(read)
    present = np.flatnonzero(read_state.grasp.present)
    assert len(present) == len(state.links)
    order = []
    for link, point in zip(state.links, state.grasp.points, strict=True):
        names = [model.body(int(read_state.bodies[i])).name or f"body {read_state.bodies[i]}" for i in present]
        miss = np.linalg.norm(read_state.grasp.points[present] - point, axis=-1)
        order.append(present[np.argmin(np.where(np.array(names) == link, miss, np.inf))])
    assert len(set(order)) == len(order)
    return read_state, np.array(order, int)


def compare(read, state, model, force_tolerance: float = 1e-9, place_tolerance: float = 1e-8) -> None:
    read_state, order = matched(read, state, model)
    grasp = read_state.grasp
    scale = np.abs(state.forces).sum()
    tolerances = {"points": place_tolerance, "normals": 100 * place_tolerance, "friction": 1e-12}
    tolerances["squeeze"] = max(force_tolerance, 1e-9) * scale
    for name, tolerance in tolerances.items():
        got, expected = getattr(grasp, name)[order], getattr(state.grasp, name)
        np.testing.assert_allclose(got, expected, atol=tolerance, err_msg=name)
    np.testing.assert_allclose(read_state.depths[order], state.depths, atol=place_tolerance)
    np.testing.assert_allclose(read_state.wrench, state.wrench, atol=1e-9)
    np.testing.assert_allclose(read_state.forces[order], state.forces, atol=force_tolerance * scale)
    absent = grasp.present == 0
    assert not read_state.forces[absent].any() and (read_state.bodies[absent] == -1).all()
    check_grasp(grasp)


@pytest.mark.parametrize(("cone", "condim"), [("elliptic", 3), ("pyramidal", 3), ("elliptic", 1), ("pyramidal", 1)])
def test_a_state_of_mujocos_reads_the_same_in_mjx(cone, condim):
    """The engine's own numbers in MJX's arrays, so that nothing but the reading is judged."""
    model, data = held(cone, condim)
    state = from_mujoco(model, data, "object", squeeze="stiffness", stiffness=700.0)
    assert set(state.links) == {"left", "right"} and np.abs(state.forces).sum() > 0.1
    read = from_mjx(mjx.put_model(model), mjx.put_data(model, data), "object", squeeze="stiffness", stiffness=700.0)
    compare(read, state, model)


@pytest.mark.filterwarnings("ignore:rolling friction")
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_rows_of_moments_are_told_from_rows_of_forces(cone):
    model, data = held(cone, 6)
    state = from_mujoco(model, data, "object", squeeze="normal_force")
    read = from_mjx(mjx.put_model(model), mjx.put_data(model, data), "object", squeeze="normal_force")
    compare(read, state, model)


def grip_states(*samples: int):
    """Return the states that the shipped grips were read from."""
    states = []

    def reading(model, data, body, **options):
        states.append((model, data))
        return from_mujoco(model, data, body, **options)

    before, close.from_mujoco = close.from_mujoco, reading
    try:
        for sample in samples:
            assert close.simulate(0, sample).contacts is not None, sample
    finally:
        close.from_mujoco = before
    return states


@pytest.fixture(scope="module")
def grips():
    if importlib.util.find_spec("gymnasium_robotics") is None:
        pytest.skip("needs gymnasium-robotics")
    return grip_states(*SAMPLES)


SAMPLES = (49, 33, 63)
"""Shadow hands: fingertips on a sphere, the whole hand around a sphere and around a capsule."""


def test_the_states_of_shipped_grips_read_the_same(grips):
    for model, data in grips:
        state = from_mujoco(model, data, "object")
        mjx_model = mjx.put_model(model)
        read_state = from_mjx(mjx_model, mjx.put_data(model, data), "object")
        compare(read_state, state, model)
        # MJX looks at many more pairs than touch: those that are kept are the same.
        count = len(state.links)
        compare(from_mjx(mjx_model, mjx.put_data(model, data), "object", max_contacts=count), state, model)
        fewer = from_mjx(mjx_model, mjx.put_data(model, data), "object", max_contacts=1)
        assert int(fewer.dropped) == count - 1
        assert float(fewer.depths[0]) == pytest.approx(state.depths.max(), abs=1e-9)


@pytest.mark.slow
def test_mjxs_own_forces_in_a_shipped_grip_are_mujocos(grips):
    """Contacts and forces by MJX's own collision and solver, in the state that MuJoCo came to rest in."""
    for model, data in grips:
        mujoco.mj_forward(model, data)
        state = from_mujoco(model, data, "object")
        mjx_model = mjx.put_model(model)
        stepped = jax.jit(mjx.forward)(mjx_model, mjx.put_data(model, data))
        compare(from_mjx(mjx_model, stepped, "object"), state, model, 1e-3, CAPSULES)


def states_of(model, data, lifts):
    """Yield MuJoCo's states with the object lifted."""
    for lift in lifts:
        state = mujoco.MjData(model)
        state.qpos[:], state.qvel[:] = data.qpos, data.qvel
        state.qpos[4] += lift
        mujoco.mj_forward(model, state)
        yield state


LIFTS = (0.0, 5e-4, 1e-3)


def test_jitted_mapped_and_batched_it_reads_the_same():
    model, data = held()
    mjx_model, states = mjx.put_model(model), list(states_of(model, data, LIFTS))
    many = jax.tree.map(lambda *x: jnp.stack(x), *(mjx.put_data(model, state) for state in states))

    def read(data):
        state = from_mjx(mjx_model, data, "object", squeeze="normal_force")
        return state, jaxgrasp.closed_form(state.grasp, state.wrench).forces

    mapped, forces = jax.jit(jax.vmap(read))(many)
    assert mapped.wrench.shape == (3, 6) and mapped.grasp.points.shape[0] == 3
    # Data that come with leading axes need no vmap.
    batched = from_mjx(mjx_model, many, "object", squeeze="normal_force")
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-14), batched, mapped)
    for i, mujoco_data in enumerate(states):
        state, single_state = (
            from_mujoco(model, mujoco_data, "object", squeeze="normal_force"),
            jax.tree.map(lambda x, i=i: x[i], mapped),
        )
        compare(single_state, state, model)
        _, order = matched(single_state, state, model)
        expected = jaxgrasp.closed_form(state.grasp, state.wrench).forces
        np.testing.assert_allclose(forces[i][order], expected, atol=1e-9)


@pytest.mark.slow
def test_mjxs_own_step_mapped_over_states_has_mujocos_contacts_and_forces():
    model, data = held()
    mjx_model, start = mjx.put_model(model), mjx.put_data(model, data)

    @jax.jit
    @jax.vmap
    def read(lift):
        moved = start.replace(qpos=start.qpos.at[4].add(lift))
        return from_mjx(mjx_model, mjx.forward(mjx_model, moved), "object")

    mapped = read(jnp.array(LIFTS))
    for i, mujoco_data in enumerate(states_of(model, data, LIFTS)):
        state = from_mujoco(model, mujoco_data, "object")
        compare(jax.tree.map(lambda x, i=i: x[i], mapped), state, model, 1e-3, CAPSULES)


def test_a_wrench_on_the_body_and_weightlessness_are_in_the_wrench():
    model, data = held()
    data.xfrc_applied[model.body("object").id] = [1, 2, 3, 0.1, 0.2, 0.3]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    mujoco.mj_forward(model, data)
    read = from_mjx(mjx.put_model(model), mjx.put_data(model, data), "object")
    np.testing.assert_allclose(read.wrench, from_mujoco(model, data, "object").wrench, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"body": "cup"}, "body is 'cup': expected a body of this model, such as left, right, far, object, body 5"),
        ({"body": 99}, "body is 99: expected an id from 0 to 5"),
        ({"body": "far"}, "body is 'far', which cannot move"),
        ({"squeeze": "depth"}, "squeeze is 'depth': expected 'stiffness' or 'normal_force'"),
        ({"squeeze": "stiffness", "stiffness": -1.0}, "stiffness is -1.0: expected a finite number, zero or more"),
        ({"max_contacts": 0}, "max_contacts is 0: expected 1 or more"),
        ({"data": 3.0}, "data is a float: expected mjx.Data of MJX's own implementation in JAX"),
    ],
)
def test_bad_arguments_are_named(unchecked, arguments, message):
    model, data = held()
    options = {"data": mjx.put_data(model, data), "body": "object"} | arguments
    with pytest.raises(ValueError, match=message):
        from_mjx(mjx.put_model(model), **options)
