"""Loads on an object that are not in its wrench are named by ``from_mjx`` in the words of ``from_mujoco``."""

import contextlib
import io
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.interop import from_mjx, from_mujoco
from tests.interop.test_mujoco_objects import LOADED, SLIDES, THRUST

mujoco = pytest.importorskip("mujoco")
# It says on import which of its engines are missing.
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    mjx = pytest.importorskip("mujoco.mjx")

DEFAULTS = {"option": "", "joints": "<freejoint/>", "equality": "", "actuator": ""}
COMPENSATED = LOADED.replace('<body name="box"', '<body name="box" gravcomp="0.7"')


def loaded(text=LOADED, applied=0.0, pull=0.0, **change):
    """Return a box that stands on a plane under a load, turned so that its axes and the world's differ."""
    model = mujoco.MjModel.from_xml_string(text.format(**DEFAULTS | change))
    data = mujoco.MjData(model)
    data.ctrl[:] = 5.0
    data.qfrc_applied[2], data.xfrc_applied[1, 0] = applied, pull
    mujoco.mj_step(model, data, 300)
    data.qpos[3:7] = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
    mujoco.mj_forward(model, data)
    return model, data


def sentences_of(read) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read()
    return sorted(str(warning.message) for warning in caught)


@pytest.mark.parametrize(
    ("state", "count"),
    [
        ({"equality": '<weld name="clamp" body1="box"/>'}, 1),
        ({"equality": '<connect body1="lid" anchor="0 0 0"/>'}, 1),
        ({"equality": '<joint joint1="hinge"/>'}, 0),
        ({"actuator": THRUST}, 1),
        ({"option": 'density="1.2" wind="3 0 0"'}, 1),
        ({"applied": 20.0, "actuator": THRUST}, 2),
        ({"joints": SLIDES}, 1),
        ({"pull": 3.0}, 0),
        ({"text": COMPENSATED}, 0),
        ({}, 0),
    ],
    ids=str,
)
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_loads_are_named_in_the_words_of_from_mujoco(state, count, cone):
    """``xfrc_applied`` and compensated weight are in the wrench of either, and are not mentioned."""
    state = state | {"option": f'{state.get("option", "")} cone="{cone}"'}
    model, data = loaded(**state)
    expected = sentences_of(lambda: from_mujoco(model, data, "box", accelerating=True))
    assert len(expected) == count
    assert sentences_of(lambda: from_mjx(mjx.put_model(model), mjx.put_data(model, data), "box")) == expected


def test_of_many_states_one_that_is_loaded_is_enough_and_traced_ones_are_silent():
    model, data = loaded()
    mjx_model, rest = mjx.put_model(model), mjx.put_data(model, data)
    loads = jnp.zeros((3, model.nv)).at[1, 2].set(20.0)
    states = jax.vmap(lambda load: rest.replace(qfrc_applied=load))(loads)
    assert sentences_of(lambda: from_mjx(mjx_model, states, "box")) == [
        "body 'box' is loaded by qfrc_applied, which is not in the wrench"
    ]
    assert sentences_of(lambda: jax.jit(lambda states: from_mjx(mjx_model, states, "box").wrench)(states)) == []
