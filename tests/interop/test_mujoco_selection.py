"""Laws of ``hand=`` and ``exclude=``: they split the contacts of an object, the same in MuJoCo and in MJX."""

import contextlib
import io

import jax
import numpy as np
import pytest

from jaxgrasp.interop import from_mjx, from_mujoco

mujoco = pytest.importorskip("mujoco")
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    mjx = pytest.importorskip("mujoco.mjx")

SCENE = """
<mujoco>
  <option cone="elliptic" jacobian="dense"/>
  <worldbody>
    <geom name="floor" type="plane" pos="0 0 -0.0395" size="1 1 .1"/>
    <body name="table" pos="0 0.0485 0"><geom name="edge" type="sphere" size=".02"/></body>
    <body name="palm" pos="0 -0.1 0">
      <joint name="lift" type="slide" axis="0 1 0"/>
      <geom name="palm" type="sphere" size=".01" mass=".1"/>
      <body name="index" pos="-0.049 0.1 0">
        <joint name="index" type="slide" axis="1 0 0"/>
        <geom name="tip" type="sphere" size=".02" mass=".2"/>
      </body>
      <body name="thumb" pos="0.049 0.1 0">
        <joint name="thumb" type="slide" axis="1 0 0"/>
        <geom type="sphere" size=".02" mass=".2"/>
        <body name="nail" pos="-.023 .01 .033"><geom name="nail" type="sphere" size=".005" mass=".01"/></body>
      </body>
    </body>
    <body name="object">
      <freejoint/>
      <geom name="ball" type="sphere" size=".03" mass=".1"/>
      <body name="knob" pos="0.01 0.01 0.03">
        <joint name="turn" axis="0 0 1" damping=".01"/>
        <geom name="head" type="sphere" size=".012" mass=".05"/>
      </body>
      <body name="foot" pos="0 0 -0.03"><geom name="foot" type="sphere" size=".01" mass=".02"/></body>
    </body>
    <body name="sensor" pos="0 0 1"><joint type="slide"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
  </worldbody>
</mujoco>
"""
ALL = ["floor", "edge", "tip", "geom 4", "nail"]
"""Geoms that touch the object, one contact each."""


@pytest.fixture(scope="module")
def scene():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    object_geoms = {model.geom(name).id for name in ("ball", "head", "foot")}
    outside = [({*c.geom.tolist()} - object_geoms) for c in data.contact if len({*c.geom.tolist()} & object_geoms) == 1]
    assert sorted(model.geom(*geoms).name or f"geom {min(geoms)}" for geoms in outside) == sorted(ALL)
    return model, data, (mjx.put_model(model), mjx.put_data(model, data))


def geoms_of(model, data, read):
    """Return the names of the geoms that touch, by the points of their contacts."""
    center = data.subtree_com[model.body("object").id]
    object_geoms = {model.geom(name).id for name in ("ball", "head", "foot")}
    names = []
    for point in read.grasp.points:
        (contact,) = (
            c for c in data.contact if np.allclose(c.pos - center, point, atol=1e-9) and {*c.geom} - object_geoms
        )
        (geom,) = {*contact.geom.tolist()} - object_geoms
        names.append(model.geom(geom).name or f"geom {geom}")
    return sorted(names)


SELECTIONS = [
    ({"hand": "palm"}, ["tip", "geom 4", "nail"]),
    ({"hand": "thumb"}, ["geom 4", "nail"]),
    ({"hand": ["index", "nail"]}, ["tip", "nail"]),
    ({"hand": "tip"}, ["tip"]),
    ({"hand": 4}, ["geom 4", "nail"]),
    ({"hand": "world"}, ["floor"]),
    ({"hand": ("palm", "table")}, ["edge", "tip", "geom 4", "nail"]),
    ({"exclude": "palm"}, ["floor", "edge"]),
    ({"exclude": ("table", "floor")}, ["tip", "geom 4", "nail"]),
    ({"exclude": "world"}, ["edge", "tip", "geom 4", "nail"]),
    ({"exclude": "foot"}, ["edge", "tip", "geom 4", "nail"]),
    ({"exclude": [("knob", "nail")]}, ["floor", "edge", "tip", "geom 4"]),
    ({"exclude": [("thumb", "head"), "floor"]}, ["edge", "tip", "geom 4"]),
    ({"exclude": [("foot", "palm")]}, ALL),
    ({"hand": "palm", "exclude": ["tip", ("palm", "knob")]}, ["geom 4"]),
]


def wrench_of(read) -> np.ndarray:
    torques = np.cross(read.grasp.points, read.forces) + read.moments
    return np.concatenate([read.forces.sum(0), torques.sum(0)])


@pytest.mark.parametrize(("options", "expected"), SELECTIONS, ids=str)
def test_selected_contacts_are_those_of_the_named_elements(scene, options, expected):
    model, data, _ = scene
    read, unselected = from_mujoco(model, data, "object", **options), from_mujoco(model, data, "object")
    assert geoms_of(model, data, read) == sorted(expected)
    np.testing.assert_allclose(wrench_of(read) + read.other_wrench, wrench_of(unselected), atol=1e-12)
    np.testing.assert_array_equal(read.wrench, unselected.wrench)
    np.testing.assert_array_equal(unselected.other_wrench, 0)


@pytest.mark.parametrize("index", [0, 8, 11, 14])
def test_mjx_selects_the_same(scene, index):
    model, data, in_mjx = scene
    options, expected = SELECTIONS[index]
    state, read = from_mujoco(model, data, "object", **options), jax.device_get(from_mjx(*in_mjx, "object", **options))
    present = read.grasp.present > 0
    assert present.sum() == len(expected) < len(present)
    order = [np.lexsort(points.round(9).T) for points in (state.grasp.points, read.grasp.points[present])]
    for name in ("forces", "depths", "moments"):
        got, expected_values = getattr(read, name)[present][order[1]], getattr(state, name)[order[0]]
        np.testing.assert_allclose(got, expected_values, atol=1e-9, err_msg=name)
    names = [model.body(int(i)).name for i in read.bodies[present][order[1]]]
    assert names == [state.links[i] for i in order[0]]
    np.testing.assert_allclose(read.other_wrench, state.other_wrench, atol=1e-9)
    np.testing.assert_allclose(read.wrench, state.wrench, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hand": "plam"}, "hand is 'plam': expected a body, geom or flex of this model; did you mean 'palm'?"),
        (
            {"hand": ["palm", "%"]},
            r"hand\[1\] is '%': expected a body, geom or flex of this model, such as world, table",
        ),
        ({"hand": ""}, "hand is '': expected a body, geom or flex"),
        ({"hand": []}, "hand is empty"),
        ({"hand": 99}, "hand is 99: expected an id from 0 to 9"),
        ({"hand": [-1]}, r"hand\[0\] is -1: expected an id from 0 to 9"),
        ({"hand": [2.0]}, r"hand\[0\] is 2.0: expected a name or the id of a body"),
        ({"hand": "knob"}, "hand is 'knob', a part of body 'object'"),
        ({"hand": "sensor"}, "hand is 'sensor': neither it nor a body below it has a geom"),
        ({"exclude": "tabel"}, "exclude is 'tabel': .* did you mean 'table'"),
        ({"exclude": ["floor", "tabel"]}, r"exclude\[1\] is 'tabel'"),
        ({"exclude": "object"}, "exclude is 'object': no contact of body 'object' would be left"),
        ({"exclude": [("table", "tabel")]}, r"exclude\[0\]\[1\] is 'tabel'"),
        ({"exclude": [("table", "floor")]}, r"exclude\[0\] is \('table', 'floor'\): expected a part of body 'object'"),
        ({"exclude": [("knob", "foot")]}, r"exclude\[0\] is \('knob', 'foot'\): expected a part of body 'object' and"),
        ({"exclude": [("knob", "foot", "tip")]}, r"exclude\[0\] is \('knob', 'foot', 'tip'\): expected a name"),
        ({"stiffness": 5.0}, "stiffness is given, but squeeze='normal_force' does not use it"),
    ],
    ids=str,
)
def test_what_cannot_be_meant_is_named(scene, unchecked, options, message):
    model, data, in_mjx = scene
    with pytest.raises(ValueError, match=message):
        from_mujoco(model, data, "object", **options)
    with pytest.raises(ValueError, match=message):
        from_mjx(*in_mjx, "object", **options)


def test_a_name_of_a_body_and_of_a_geom_elsewhere_is_refused():
    model = mujoco.MjModel.from_xml_string(SCENE.replace('name="edge"', 'name="thumb"'))
    data = mujoco.MjData(model)
    with pytest.raises(ValueError, match="hand is 'thumb', the name of a body and a geom: rename one"):
        from_mujoco(model, data, "object", hand="thumb")
    # The geom of that name on the body itself leaves no doubt.
    from_mujoco(model, data, "object", hand="palm")
