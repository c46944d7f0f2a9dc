"""Scenes in TOML files: what they leave out, what is wrong with them, and that hand and object stand as they say."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.grip import Body, GripType, observe, power_grip, simulate
from jaxgrasp.grip.scene_entries import GuideEntry, TableEntry
from jaxgrasp.grip.scene_file import SceneFile, gripped_scene, load_scene, ready_scenes
from jaxgrasp.grip.simulation import lift_and_turn, stacked
from jaxgrasp.grip.table_support import support_points
from jaxgrasp.hand import Cylinder, closing_kinematics
from jaxgrasp.lab.loaded_scene import loaded_scene
from tests.hand.hands import rotations
from tests.interop.test_mujoco_hand import model_of


def ready_scene(name: str) -> SceneFile:
    return load_scene(ready_scenes()[name])


def test_an_empty_file_is_the_ready_cylinder(folder):
    (folder / "empty.toml").write_text("")
    assert load_scene("empty.toml") == load_scene(ready_scenes()["cylinder"]) == SceneFile()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[objekt]\nmass = 1", "'objekt': did you mean 'object'?"),
        ("[object]\nmas = 1", "object has 'mas': did you mean 'mass'?"),
        ("[object]\nmass = -1", "object: mass is -1.0: expected a positive number"),
        ('[object]\nmass = "heavy"', "object.mass is 'heavy': expected a number"),
        ("[object]\nradius = inf", "object.radius is inf: expected a number"),
        ("[object]\nfriction = -0.1", "object: friction is -0.1: expected a finite number, 0 or more"),
        ("[object]\ntorsion = -1", "object: torsion is -1.0: expected a finite number, 0 or more"),
        ("[object]\ntorsion = nan", "object.torsion is nan: expected a number"),
        ('[object]\nshape = "cone"', "object.shape is 'cone': did you mean 'cylinder'?"),
        ('[hand]\nside = "both"', "hand.side is 'both'"),
        ("[hand]\nlength = 0", "hand: length is 0.0: expected a positive number"),
        ('[grip]\nkind = "precision"', "grip.kind is 'precision': did you mean 'precision-5'?"),
        ("[table]\nbelow = -1", "table: below is -1.0: expected a finite number, 0 or more"),
        ("[world]\ngravity = [0, 0]", "world: gravity is [0.0, 0.0]: expected three finite numbers"),
        ("hand = 3", "hand is 3: expected a table"),
        ("name = 3", "name is 3: expected text"),
        ("[object]\nsize = [1, 1, 1]", "object: size is [1.0, 1.0, 1.0]: expected radius and height"),
        ('[object]\nshape = "box"\nsize = [1, 0, 1]', "object: size is [1.0, 0.0, 1.0]: expected three positive"),
        ("[object]\ncentre_of_mass = [0, 1]", "object: centre_of_mass is [0.0, 1.0]: expected three finite numbers"),
        ("[object]\ninertia = [1, 1]", "object: inertia is [1.0, 1.0]: expected xx, yy, zz, or these and xy, xz, yz"),
        ("[object]\ninertia = [1, 1, 3]", "none above the sum of the other two, not 1, 1, 3 kg.m^2"),
        ("[object]\ninertia = [1, 1, 1, 2, 0, 0]", "expected positive principal moments"),
        ('[hand]\nfile = "hand.xml"', "hand.file is 'hand.xml': there is no such file"),
        ('[hand]\nwrist = "palm"', "hand: wrist is 'palm': expected none, since a human hand has no file"),
        ("[hand.open]\nthumb = 1", "hand: open is {'thumb': 1.0}: expected none, since a human hand has no file"),
        ('[hand]\nopen = {thumb = "far"}', "hand.open.thumb is 'far': expected a number"),
        ('[hand]\nfile = "x"\nlinks = {palm = "middle"}', "hand: links['palm'] is 'middle': expected a finger and a"),
        ('[object]\nmesh = "cup.stl"', "object.mesh is 'cup.stl': there is no such file"),
        ("[obstacle]\nat = [0, 0, 1]", "obstacle is {'at': [0, 0, 1]}: expected tables [[obstacle]]"),
        ("[[obstacle]]\nradius = 0.1", "obstacle[0] has no 'at'"),
        ("[[obstacle]]\nat = [0, 0]", "obstacle[0]: at is [0.0, 0.0]: expected three finite numbers"),
        ("[[obstacle]]\nat = [0, 0, 1]\nstiffness = -1", "obstacle[0]: stiffness is -1.0"),
        (
            "[[obstacle]]\nat = [0, 0, 1]\npath = [[0, 1]]",
            "obstacle[0]: path[0] is [0.0, 1.0]: expected a time and three",
        ),
        ("[[obstacle]]\nat = [0, 0, 1]\npath = [0, 1, 2, 3]", "obstacle[0].path[0] is 0: expected a list"),
        (
            "[[obstacle]]\nat = [0, 0, 1]\npath = [[1, 0, 0, 0], [1, 0, 0, 1]]",
            "obstacle[0]: path[1] begins at 1 s: expected later than 1 s",
        ),
        ("[[obstacle]]\nat = [0, 0, 1]\ndamping = -1", "obstacle[0]: damping is -1.0: expected a finite number, 0 or"),
        ("[table]\ntouches_hand = 1", "table.touches_hand is 1: expected true or false"),
        ("[other]\nat = [0, 0, 1]", "other is {'at': [0, 0, 1]}: expected tables [[other]]"),
        ("[[other]]\nmass = 1", "other[0] has no 'at'"),
        ("[[other]]\nat = [0, 0, 1]\nmas = 1", "other[0] has 'mas': did you mean 'mass'?"),
        (
            "[[other]]\nat = [0, 0, 1]\n[[other]]\nat = [0, 0, 2]\nmass = 0",
            "other[1]: mass is 0.0: expected a positive",
        ),
        ("[[other]]\nat = [0, 0, 1]\nrubbing = -1", "other[0]: rubbing is -1.0: expected a finite number, 0 or more"),
        ("[[other]]\nat = [0, 0, 1]\nturn = [0, 1]", "other[0]: turn is [0.0, 1.0]: expected three finite numbers"),
        ('[[other]]\nat = [0, 0, 1]\nmesh = "cup.stl"', "other[0].mesh is 'cup.stl': there is no such file"),
        ('[guide]\nkind = "hinge"', "guide has no 'axis'"),
        ('[guide]\nkind = "hinge"\naxis = [0, 0, 0]', "guide: axis is [0.0, 0.0, 0.0]: expected a direction"),
        ('[guide]\nkind = "slide"\naxis = [0, 0, 1]\npitch = 1', "guide: pitch is 1.0: expected 0 for a slide"),
        ('[guide]\nkind = "rail"\naxis = [0, 0, 1]', "guide.kind is 'rail'"),
        ("[object", "is no TOML"),
        ("hand = " + 900 * "[" + 900 * "]", "nested too deeply"),
        ("[object]\nmass = " + 5000 * "1", "is no TOML"),
        ('[object]\nmesh = "' + 5000 * "x" + '"', "there is no such file"),
        ('name = "' + 1000 * "x" + '"', "name has 1000 characters: expected at most 200"),
    ],
)
def test_what_is_wrong_is_said_by_table_and_key_before_anything_compiles(folder, capsys, text, words):
    (folder / "scene.toml").write_text(text)
    for command in (
        ["scene", "check", "scene.toml"],
        ["glove", "run", "scene.toml"],
        ["grip", "--scene", "scene.toml"],
    ):
        assert main(command) == 1
        message = capsys.readouterr().err
        assert words in message and message.count("\n") == 1


def test_ready_scenes_are_listed_and_checked(folder, capsys):
    assert main(["scene", "list"]) == 0
    output = capsys.readouterr().out
    for name in ready_scenes():
        assert name in output and main(["scene", "check", name]) == 0
    assert main(["scene", "check", "nowhere"]) == 1
    assert (
        "scene is 'nowhere': expected a TOML file, or one of ball, box, cylinder, door_handle, peg, stack"
        in capsys.readouterr().err
    )


@pytest.mark.slow
def test_what_begins_inside_the_object_is_refused(folder, capsys):
    (folder / "scene.toml").write_text("[[obstacle]]\nat = [0, 0, 1]\n[[obstacle]]\nat = [0.0, 0.0, 0.04]")
    assert main(["grip", "--scene", "scene.toml"]) == 1
    message = capsys.readouterr().err.splitlines()[-1]
    assert "obstacle[1] begins" in message and "mm deep in the object: expected it outside" in message


def test_a_guide_leaves_its_axis_where_it_is():
    """Points of a hinge's axis stay, those of a screw's go along it by the pitch, all of a slide alike."""
    rng = np.random.default_rng(5)
    axis, through, centre, along = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), rng.normal()
    axis_fields = {"axis": tuple(axis), "through": tuple(through)}
    on_axis, elsewhere = centre + through + along * axis, rng.normal(size=3)
    unit = axis / np.linalg.norm(axis)

    def velocity(entry: GuideEntry, point: np.ndarray) -> np.ndarray:
        twist = entry.twists(centre)[:, 0]
        return twist[:3] + np.cross(twist[3:], point)

    hinge, screw = GuideEntry(kind="hinge", **axis_fields), GuideEntry(kind="screw", pitch=0.3, **axis_fields)
    np.testing.assert_allclose(velocity(hinge, on_axis), 0, atol=1e-14)
    np.testing.assert_allclose(velocity(screw, on_axis), 0.3 * unit, atol=1e-14)
    np.testing.assert_allclose(velocity(hinge, elsewhere), np.cross(unit, elsewhere - on_axis), atol=1e-14)
    np.testing.assert_allclose(velocity(GuideEntry(kind="slide", **axis_fields), elsewhere), unit, atol=1e-14)
    for size in (1e-320, 1e300):
        slide = GuideEntry(kind="slide", axis=(size, size, 0.0))
        np.testing.assert_allclose(slide.twists(centre)[:3, 0], [np.sqrt(0.5), np.sqrt(0.5), 0], rtol=1e-3)


@pytest.mark.slow
def test_a_handle_turns_about_its_hinge_and_goes_nowhere_else(folder):
    """The handle's end stays at the distance from the hinge that the file gives, wherever the hand takes it."""
    file = ready_scene("door_handle")
    made = gripped_scene(file)
    times = np.linspace(0, 1, 21)
    postures = lift_and_turn(made.closed, times, lift=0.02, turn=0.1, axis=np.array([1.0, 0.0, 0.0]))
    record = stacked(simulate(made.scene, postures, made.placed, 0.05, law="optimum"))
    end = np.einsum("ji,j->i", np.asarray(made.placed.rotation), np.array(file.guide.through))
    ends = record.placed.origin + np.einsum("tij,j->ti", record.placed.rotation, end)
    np.testing.assert_allclose(ends, np.broadcast_to(ends[0], ends.shape), atol=1e-9)
    assert np.abs(record.placed.origin[-1] - record.placed.origin[0]).max() > 5e-3


@pytest.mark.slow
def test_a_mesh_is_held_as_the_shape_that_it_is_of(folder):
    """A box of triangles, written by hand: as many contacts, no deeper than the exact shape's."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.05, 0.05, 0.12)).export(folder / "block.stl")
    (folder / "mesh.toml").write_text('[object]\nmesh = "block.stl"\n[grip]\ndepth = 0.002')
    (folder / "exact.toml").write_text('[object]\nshape = "box"\nsize = [0.05, 0.05, 0.12]\n[grip]\ndepth = 0.002')
    by_mesh, exact = (gripped_scene(load_scene(folder / name)) for name in ("mesh.toml", "exact.toml"))
    assert abs(int(by_mesh.contacts.present.sum()) - int(exact.contacts.present.sum())) <= 2
    # Its longest axis lies across the palm, as the exact box's does.
    for moments in zip(by_mesh.scene.body.shape._moments(), exact.scene.body.shape._moments(), strict=True):
        np.testing.assert_allclose(*moments, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cylinder", "ball", "box", "door_handle", "peg"])
def test_the_object_stands_as_far_above_the_table_as_the_file_says(name):
    file = ready_scene(name)
    made = gripped_scene(file)
    _, heights = support_points(made.scene, made.placed)
    np.testing.assert_allclose(heights, file.table.below, atol=1e-5)
    assert made.contacts.present.sum() >= 3 and made.scene.table_friction == file.table.friction


@pytest.mark.slow
def test_an_object_hangs_by_its_centre_of_mass():
    """The same cylinder and hand; forces in the world balance the weight where the file has it, and nowhere else."""
    file = replace(ready_scene("cylinder"), table=TableEntry(below=0.1))
    whole_scene = gripped_scene(file)
    centre = (0.004, -0.003, 0.02)
    made = gripped_scene(replace(file, object=replace(file.object, centre_of_mass=centre)))
    center_of_mass = whole_scene.placed.origin + whole_scene.placed.rotation @ np.array(centre)
    np.testing.assert_allclose(made.placed.origin, center_of_mass, atol=1e-15)
    np.testing.assert_allclose(made.contacts.points, whole_scene.contacts.points, atol=1e-15)
    tick = observe(made.scene, made.closed, made.placed, law="optimum")
    np.testing.assert_allclose(tick.contacts.points, whole_scene.contacts.points, atol=1e-12)
    np.testing.assert_allclose(tick.exerted.sum(0), [0, 0, 9.81 * file.object.mass], atol=1e-6)
    np.testing.assert_allclose(np.cross(tick.contacts.points - center_of_mass, tick.exerted).sum(0), 0, atol=1e-7)
    np.testing.assert_allclose(
        made.scene.body.inertia_matrix(), whole_scene.scene.body.inertia_matrix(), rtol=1e-12, atol=1e-18
    )


@pytest.mark.slow
def test_the_mass_of_a_mesh_lies_in_the_frame_of_its_file(folder):
    """A box of triangles far from its file's origin, turned; its own data are given there as they would be measured."""
    trimesh = pytest.importorskip("trimesh")
    turn = rotations(1, np.random.default_rng(4))[0]
    box = trimesh.creation.box((0.05, 0.06, 0.12))
    box.apply_transform(np.block([[turn, np.array([[0.1], [0.2], [0.3]])], [np.zeros((1, 3)), np.ones((1, 1))]]))
    box.export(folder / "block.stl")
    moments = 0.15 / 12 * np.array([0.06**2 + 0.12**2, 0.05**2 + 0.12**2, 0.05**2 + 0.06**2])
    tensor = turn @ np.diag(moments) @ turn.T
    six = [float(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    text = f'[object]\nmesh = "block.stl"\ninertia = {six}\ncentre_of_mass = [0.1, 0.2, 0.3]'
    (folder / "scene.toml").write_text(text)
    body, centre = load_scene("scene.toml").object.body()
    np.testing.assert_allclose(centre, 0, atol=1e-6)
    uniform = Body(body.shape, 0.15)
    np.testing.assert_allclose(body.inertia_matrix(), uniform.inertia_matrix(), atol=1e-6 * moments.max())


@pytest.mark.slow
def test_a_hand_out_of_a_file_closes_on_the_object(folder, capsys):
    """The Shadow hand of a MuJoCo file: its own joints and links, and a glove that lacks them is told so."""
    model_of("shadow")
    path = Path(importlib.util.find_spec("gymnasium_robotics").origin).parent / "envs" / "assets" / "hand" / "reach.xml"
    text = f"""
        object = {{ radius = 0.025 }}
        hand = {{ file = "{path}", wrist = "robot0:palm", open = {{ "robot0:THJ3" = 1.2 }} }}
        grip = {{ depth = 0.002 }}"""
    (folder / "shadow.toml").write_text(text)
    made = loaded_scene(load_scene("shadow.toml"))
    hand, options = made.scene.hand, {"open": {"robot0:THJ3": 1.2}}
    closed, placed, _ = power_grip(hand, Cylinder(0.025, 0.12), 0.002, closing_kinematics(hand, **options))
    np.testing.assert_array_equal(made.closed.angles, closed.angles)
    np.testing.assert_array_equal(made.placed.origin, placed.origin)
    assert made.kind == GripType.CYLINDRICAL_POWER and made.open[hand.joints.index("robot0:THJ3")] == 1.2
    assert main(["glove", "ablate", "shadow.toml"]) == 1
    assert "joint" in capsys.readouterr().err.splitlines()[-1]
    (folder / "shadow.toml").write_text(text.replace("THJ3", "THJ9"))
    assert main(["grip", "--scene", "shadow.toml"]) == 1
    assert "robot0:THJ9" in capsys.readouterr().err.splitlines()[-1]
