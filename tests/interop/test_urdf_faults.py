"""URDF files as robots ship with them: what a Hand does not need is dropped by name, and faults are named."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxgrasp.cli.main import main
from jaxgrasp.interop import hand_from_urdf, read_hand

pytest.importorskip("mujoco")

SPHERE = '<sphere radius="0.01"/>'
BLOCK = trimesh.creation.box((0.02, 0.02, 0.06))
FLAT = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]], process=False)


def finger(name: str, shape: str = SPHERE, joint: str = "j1", inertial: str = "", parent: str = "palm") -> str:
    return (
        f'<link name="{name}">{inertial}<collision><geometry>{shape}</geometry></collision></link>'
        f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="2" velocity="1"/></joint>'
    )


def urdf(*fingers: str, head: str = '<robot name="h">') -> str:
    palm = '<link name="palm"><collision><geometry><box size=".05 .05 .02"/></geometry></collision></link>'
    return f"{head}{palm}{''.join(fingers)}</robot>"


def inertial(mass: str = "0.5", **entries: str) -> str:
    values = {"ixx": ".001", "iyy": ".001", "izz": ".001", "ixy": "0", "ixz": "0", "iyz": "0"} | entries
    pairs = " ".join(f'{key}="{value}"' for key, value in values.items())
    return f'<inertial><mass value="{mass}"/><inertia {pairs}/></inertial>'


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (inertial(ixx="-.0012", iyy="-.0011"), "its least principal moment is -0.0012 kg m^2"),
        (inertial(ixy=".002"), "its least principal moment is -0.001 kg m^2"),
        (inertial("nan"), "one of its entries is not a finite number"),
        (inertial("heavy"), "one of its entries is not a number"),
        (inertial("-1"), "the mass is -1 kg"),
        ("<inertial/>", "it has no mass"),
        (inertial("0", ixx="0", iyy="0", izz="0"), None),
        (inertial(izz=".1"), None),  # no body has it either, but MuJoCo balances it
    ],
)
def test_an_inertia_that_no_body_can_have_is_dropped_by_name(folder, text, fault):
    (folder / "h.urdf").write_text(urdf(finger("a", inertial=text)))
    read = read_hand("h.urdf")
    assert [joint.name for joint in read.joints] == ["j1"] and [link.name for link in read.links] == ["palm", "a"]
    messages = [str(note) for note in read.left_out if note.part.startswith("inertia")]
    assert messages == ([f"inertia of link 'a': {fault}: a Hand needs none, the model's is made up"] if fault else [])
    assert not any(note.missing for note in read.left_out)


def capsule(folder: Path, name: str) -> np.ndarray:
    (folder / "h.urdf").write_text(urdf(finger("a", f'<mesh filename="{name}"/>')))
    return hand_from_urdf("h.urdf", "palm").model.geom_size[1]


def test_a_mesh_is_the_same_in_every_format(folder):
    """MuJoCo reads the first two, trimesh the others; of a scene the places of its parts count."""
    for name in ("a.stl", "a.obj", "a.ply", "a.off", "a.glb"):
        BLOCK.export(folder / name)
    (folder / "text.stl").write_text(trimesh.exchange.stl.export_stl_ascii(BLOCK))
    sizes = [capsule(folder, name) for name in ("a.stl", "a.obj", "a.ply", "a.off", "a.glb", "text.stl")]
    np.testing.assert_allclose(sizes, [sizes[0]] * 6, rtol=1e-6)
    np.testing.assert_allclose(sizes[0][:2], [0.01, 0.025], rtol=1e-6)


def collada(meter: float, scene: bool = True) -> str:
    points = " ".join(f"{x / meter:g}" for x in BLOCK.vertices.ravel())
    faces = " ".join(map(str, BLOCK.faces.ravel()))
    node = '<node id="n"><instance_geometry url="#g"/></node>'
    shown = (
        f'<library_visual_scenes><visual_scene id="s">{node}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene>'
    )
    accessor = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset><unit name="u" meter="{meter}"/></asset><library_geometries><geometry id="g"><mesh><source id="p">'
        f'<float_array id="pa" count="24">{points}</float_array><technique_common>'
        f'<accessor source="#pa" count="8" stride="3">{accessor}</accessor></technique_common></source>'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="12">'
        f'<input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles></mesh></geometry>'
        f"</library_geometries>{shown if scene else ''}</COLLADA>"
    )


@pytest.mark.parametrize("meter", [1.0, 0.001])
def test_collada_is_read_in_the_unit_that_it_says(folder, meter):
    pytest.importorskip("collada")
    (folder / "f.dae").write_text(collada(meter))
    np.testing.assert_allclose(capsule(folder, "f.dae")[:2], [0.01, 0.025], rtol=1e-6)


def test_without_pycollada_the_command_that_installs_it_is_said(folder, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "collada", None)
    (folder / "f.dae").write_text(collada(1.0))
    with pytest.raises(ValueError, match=r"pip install 'jaxgrasp\[mesh\]'; keep_going=True leaves it out"):
        capsule(folder, "f.dae")


BAD_SHAPES = {
    "flat": ('<mesh filename="flat.stl" scale=".01 .01 .01"/>', "it is flat: expected a solid, which can touch"),
    "scale": ('<mesh filename="a.stl" scale="0 1 1"/>', "its scale is '0 1 1': expected three numbers other than zero"),
    "empty": ('<mesh filename="empty.obj"/>', "it holds no triangles"),
    "garbage": ('<mesh filename="bad.stl"/>', "it holds no triangles"),
    "nan": ('<mesh filename="nan.ply"/>', "its vertex 2 is [nan, 0.009999"),
    "unknown": ('<mesh filename="a.xyzzy"/>', "trimesh cannot read it: "),
    "sphere": ('<sphere radius="0"/>', "its radius is '0': expected positive numbers [m]"),
    "box": ('<box size="1 -1 1"/>', "its size is '1 -1 1': expected positive numbers [m]"),
    "cylinder": ('<cylinder radius="nan" length="1"/>', "its radius is 'nan': expected positive numbers [m]"),
}


@pytest.mark.parametrize("name", BAD_SHAPES)
def test_a_shape_that_cannot_touch_stops_a_reader_unless_it_may_go_on(folder, capsys, name):
    shape, fault = BAD_SHAPES[name]
    FLAT.export(folder / "flat.stl")
    BLOCK.export(folder / "a.stl")
    (folder / "empty.obj").write_text("nothing")
    (folder / "bad.stl").write_bytes(b"solid or not")
    (folder / "a.xyzzy").write_bytes(b"?")
    vertices = np.array(BLOCK.vertices)
    vertices[2, 0] = np.nan
    trimesh.Trimesh(vertices, BLOCK.faces, process=False).export(folder / "nan.ply")
    (folder / "h.urdf").write_text(urdf(finger("a", shape), finger("b", joint="j2")))
    with pytest.raises(ValueError, match="path is .*h.urdf.*of link 'a'") as caught:
        hand_from_urdf("h.urdf", "palm")
    assert fault in str(caught.value) and "keep_going=True leaves it out" in str(caught.value)
    read = read_hand("h.urdf", keep_going=True)
    assert [joint.name for joint in read.joints] == ["j1", "j2"]
    assert [link.name for link in read.links] == ["palm", "b"]
    (note,) = [note for note in read.left_out if note.missing]
    assert note.part.endswith("of link 'a'") and note.why.startswith(fault)
    assert main(["hand", "check", "h.urdf", "--wrist", "palm"]) == 1
    assert f"missing: {note.part}: {fault}" in capsys.readouterr().out


XACRO = '<robot name="h" xmlns:xacro="http://www.ros.org/wiki/xacro">'
EXPAND = "a xacro has to be expanded first: xacro h.urdf.xacro > h.urdf"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (urdf(finger("a"), finger("b")), "2 joints have the name 'j1'"),
        (urdf(finger("a"), finger("a", joint="j2")), "2 links have the name 'a'"),
        (urdf(finger("a")).replace('<joint name="j1"', "<joint"), "it has a joint without a name"),
        (urdf(finger("a"), finger("b", joint="j2", parent="c")), "joint 'j2' has the parent 'c': expected the name of"),
        (urdf(finger("a"), finger("b", joint="j2").replace('<child link="b"/>', "")), "'j2' has the child None"),
        (urdf(finger("a"), finger("b", joint="j2").replace('child link="b"', 'child link="a"')), "'a', which hangs on"),
        (urdf(finger("a", parent="b"), finger("b", "", joint="j2", parent="a")), "hangs on itself: expected a tree"),
        (urdf('<xacro:property name="r" value="1"/>', finger("a"), head=XACRO), f"<xacro:property>: {EXPAND}"),
        (urdf(finger("a", '<sphere radius="${r}"/>')), "<sphere> has radius='${r}': " + EXPAND),
        (urdf(finger("a", '<mesh filename="$(find hand)/a.stl"/>')), EXPAND),
        (urdf('<xacro:property name="r" value="1"/>', finger("a")), "unbound prefix"),
    ],
)
def test_faults_are_named(folder, text, message):
    (folder / "h.urdf.xacro").write_text(text)
    with pytest.raises(ValueError) as caught:
        read_hand("h.urdf.xacro")
    assert message in str(caught.value) and "h.urdf.xacro" in str(caught.value)
    assert ("xacro h.urdf.xacro >" in str(caught.value)) == ("xacro:" in text or "$" in text)


def test_an_expanded_xacro_is_a_urdf(folder):
    (folder / "h.urdf").write_text(urdf(finger("a"), head=XACRO))
    assert [joint.name for joint in read_hand("h.urdf").joints] == ["j1"]


def test_an_mjcf_is_read_without_inertias_that_no_body_can_have(folder):
    body = '<joint name="j" axis="0 1 0" range="0 90"/><geom type="capsule" size="0.01 0.02"/>'
    odd = '<inertial pos="0 0 0" mass="1" fullinertia="-1 1 1 0 0 0"/>'
    flat = " ".join(f"{x:g}" for x in FLAT.vertices.ravel())
    asset = f'<asset><mesh name="flat" vertex="{flat}" face="0 1 2 1 3 2"/></asset>'
    for name, text in {
        "inertia": f"<mujoco><worldbody><body name='w'><body name='a'>{odd}{body}</body></body></worldbody></mujoco>",
        "flat": f"<mujoco>{asset}<worldbody><body name='w'><body name='a'>{body}</body></body></worldbody></mujoco>",
    }.items():
        (folder / f"{name}.xml").write_text(text)
        read = read_hand(f"{name}.xml")
        assert [joint.name for joint in read.joints] == ["j"], name
        assert any("inertias of 1 bodies" in note.part for note in read.left_out) == (name == "inertia")
