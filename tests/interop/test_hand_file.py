"""Hands in files: an account of every joint, link, shape and mesh, and one line for what is no hand."""

from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.interop import hand_from_urdf, load_mjcf, read_hand

mujoco = pytest.importorskip("mujoco")
SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "dexgraspnet" / "mjcf"

BOX = '<collision><geometry><box size="0.02 0.02 0.04"/></geometry></collision>'
URDF = f"""
<robot name="claw">
  <link name="arm">{BOX}</link>
  <link name="palm">{BOX}</link>
  <link name="finger">{BOX}<collision><geometry><mesh filename="claw.stl"/></geometry></collision></link>
  <link name="tip">{BOX}</link>
  <link name="sensor"/>
  <joint name="elbow" type="continuous"><parent link="arm"/><child link="palm"/><axis xyz="0 0 1"/></joint>
  <joint name="knuckle" type="revolute"><parent link="palm"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="1.5" effort="2" velocity="1"/></joint>
  <joint name="end" type="revolute"><parent link="finger"/><child link="tip"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="1" effort="0" velocity="1"/><mimic joint="knuckle" multiplier="0.5"/></joint>
  <joint name="glued" type="fixed"><parent link="tip"/><child link="sensor"/></joint>
</robot>
"""
MJCF = """
<mujoco>
  <compiler meshdir="meshes"/>
  <option apirate="200"/>
  <default><default class="seen"><geom type="mesh" contype="0" conaffinity="0"/></default></default>
  <asset><mesh name="shell" file="shell.obj"/><mesh name="block" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="palm">
      <geom name="pad" type="box" size="0.03 0.01 0.03"/>
      <geom name="look" class="seen" mesh="shell"/>
      <body name="finger">
        <joint name="knuckle" axis="0 1 0" range="-60 90"/>
        <geom name="bone" type="capsule" size="0.01 0.02"/>
        <geom name="sole" type="mesh" mesh="shell"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="gone" joint="nowhere"/><motor joint="knuckle" forcerange="-3 3"/></actuator>
</mujoco>
"""


def parts(read) -> str:
    return "\n".join(map(str, read.left_out))


def test_every_part_of_a_urdf_is_accounted_for(folder):
    (folder / "claw.urdf").write_text(URDF)
    read = read_hand("claw.urdf", "palm", keep_going=True)
    assert (read.format, read.wrist) == ("URDF", "palm")
    by_name = {joint.name: joint for joint in read.joints}
    assert list(by_name) == ["elbow", "knuckle", "end"]
    assert by_name["elbow"].use == "not below the wrist" and by_name["elbow"].limits is None
    assert by_name["knuckle"].torque_max == 2 and by_name["knuckle"].limits == (0, 1.5)
    assert by_name["end"].torque_max == np.inf and by_name["end"].use == "used, follows 'knuckle'"
    assert [(link.name, link.shapes) for link in read.links] == [(n, ("box",)) for n in ("palm", "finger", "tip")]
    parts_read = parts(read)
    assert "coupling" not in parts_read
    assert read.mujoco_hand.hand.coupling.independent == (0,)
    np.testing.assert_allclose(read.mujoco_hand.hand.coupling.matrix, [[1], [0.5]])
    assert "body 'sensor': none of its shapes can touch" in parts_read
    assert "box 'geom 0' of body 'arm': not below the wrist" in parts_read
    missing = [note for note in read.left_out if note.missing]
    assert [note.part for note in missing] == ["mesh 'claw.stl' of link 'finger'"]


def test_a_missing_mesh_stops_a_reader_unless_it_may_go_on(folder):
    (folder / "claw.urdf").write_text(URDF)
    with pytest.raises(ValueError, match=r"link 'finger' has the mesh 'claw.stl': expected that file beside the URDF"):
        hand_from_urdf("claw.urdf", "palm")
    hand = hand_from_urdf("claw.urdf", "palm", keep_going=True)
    assert hand.left_out == ("mesh 'claw.stl' of link 'finger'",)
    assert hand.coupled == () and hand.hand.coupling is not None


def test_the_wrist_is_the_last_body_that_all_joints_hang_on(folder):
    (folder / "claw.urdf").write_text(URDF)
    assert read_hand("claw.urdf", keep_going=True).wrist == "arm"
    fixed = URDF.replace('type="continuous"', 'type="fixed"')
    (folder / "claw.urdf").write_text(fixed)
    assert read_hand("claw.urdf", keep_going=True).wrist == "palm"


def test_an_old_mjcf_says_what_it_lost_and_keeps_its_motors(folder):
    (folder / "hand.xml").write_text(MJCF)
    read = read_hand("hand.xml")
    assert read.wrist == "palm"
    np.testing.assert_array_equal(read.mujoco_hand.hand.torque_max, [3])
    parts_read = parts(read)
    for line in (
        "elements option: MuJoCo refuses the file as it is: ",
        f"mesh 'shell': the file '{Path('meshes') / 'shell.obj'}' does not exist",
        "geom 'look' of body 'palm': its mesh 'shell' is missing",
        "geom 'sole' of body 'finger': its mesh 'shell' is missing",
        "motor 'gone': the file has no joint 'nowhere'",
        "plane 'floor' of body 'world': not below the wrist",
    ):
        assert line in parts_read, line


def test_a_class_of_shapes_that_are_only_seen_stays_one(folder):
    """Without its missing mesh the file is stripped; what its classes say of other meshes still holds."""
    (folder / "meshes").mkdir()
    triangles = ((1, 2, 3), (1, 2, 4), (1, 3, 4), (2, 3, 4))
    corners = ("0 0 0", "1 0 0", "0 1 0", "0 0 1")
    lines = [f"v {corner}" for corner in corners] + ["f {} {} {}".format(*triangle) for triangle in triangles]
    (folder / "meshes" / "shell.obj").write_text("\n".join(lines))
    (folder / "hand.xml").write_text(MJCF)
    model = load_mjcf("hand.xml")
    look = model.geom("look")
    assert (look.contype[0], look.conaffinity[0]) == (0, 0)
    parts_read = parts(read_hand("hand.xml"))
    assert "mesh 'sole' of body 'finger': of an MJCF file, touches only as a sphere, capsule, " in parts_read
    assert "1 shape: touch" in parts_read


def test_the_command_shows_the_account_and_fails_where_a_urdf_lacks_a_mesh(folder, capsys):
    (folder / "claw.urdf").write_text(URDF)
    assert main(["hand", "check", "claw.urdf", "--wrist", "palm"]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "URDF, wrist palm"
    assert "knuckle  hinge  0         1.5 rad  2 N.m      used" in shown
    assert "elbow    hinge  no limit           not known  not below the wrist" in shown
    assert any(
        line.startswith("missing: mesh 'claw.stl' of link 'finger': expected that file beside") for line in shown
    )
    assert shown[-1] == "2 of 3 joints used, 3 links can touch, 1 meshes missing"
    (folder / "hand.xml").write_text(MJCF)
    assert main(["hand", "check", "hand.xml"]) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not xml", "expected a URDF or MJCF file, but it is not XML: "),
        ("<sdf/>", "whose root is <robot> or <mujoco>, not <sdf>"),
        (
            '<robot name="stone"><link name="stone"/></robot>',
            "expected a hand, but it has no joint that turns or slides",
        ),
        (URDF.replace('"revolute"', '"ball"', 1), "joint 'knuckle' has the type 'ball': expected one of revolute, "),
        (URDF.replace('type="revolute"', 'type="floating"', 1), "that MuJoCo can read; it says: Error: free joint"),
        ("<mujoco><worldbody><body/></worldbody></mujoco>", "expected a hand, but it has no joint"),
    ],
)
def test_what_is_no_hand_is_one_line(folder, capsys, text, message):
    (folder / "hand").write_text(text)
    assert main(["hand", "check", "hand"]) == 1
    shown = capsys.readouterr()
    assert shown.out == "" and len(shown.err.splitlines()) == 1 and message in shown.err


def test_a_file_that_is_not_there_and_a_wrist_that_it_lacks(folder, capsys):
    assert main(["hand", "check", "none.urdf"]) == 1
    assert "path is 'none.urdf': expected a URDF or MJCF file, but there is none" in capsys.readouterr().err
    (folder / "claw.urdf").write_text(URDF)
    assert main(["hand", "check", "claw.urdf", "--wrist", "elbow"]) == 1
    assert "wrist is 'elbow': the model has no body of that name" in capsys.readouterr().err


def test_a_data_sets_shadow_hand_keeps_its_torques():
    path = SAMPLES / "shadow_hand_wrist_free.xml"
    if not path.is_file():
        pytest.skip(f"needs {SAMPLES}")
    read = read_hand(path)
    torques = {joint.name: joint.torque_max for joint in read.joints}
    assert torques["robot0:FFJ2"] == 0.9 and torques["robot0:FFJ0"] == np.inf
    follows = {joint.name: joint.use for joint in read.joints if "follows" in joint.use}
    assert follows == {f"robot0:{f}FJ0": f"used, follows 'robot0:{f}FJ1'" for f in "FMRL"}


def test_limits_that_contradict_themselves_are_said(folder):
    odd = URDF.replace('lower="0" upper="1.5" effort="2"', 'lower="2" upper="1" effort="-3"')
    (folder / "claw.urdf").write_text(odd)
    parts_read = parts(read_hand("claw.urdf", "palm", keep_going=True))
    assert "limits of joint 'knuckle': lower, 2, is above upper, 1: it has no limits here" in parts_read
    assert "effort of joint 'knuckle': it is -3, below zero: its size counts here" in parts_read
    (folder / "claw.urdf").write_text(URDF)
    assert "limits of joint" not in parts(read_hand("claw.urdf", "palm", keep_going=True))


def test_a_file_that_is_nested_without_end_is_one_line(folder):
    (folder / "deep.urdf").write_text("<robot>" + "<a>" * 300_000 + "</a>" * 300_000 + "</robot>")
    with pytest.raises(ValueError, match="deep.urdf"):
        read_hand("deep.urdf")
