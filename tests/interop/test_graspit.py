"""GraspIt!'s world files: a pinch of a cube, in millimetres."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import hand_from_mujoco, load_mjcf, read_graspit
from jaxgrasp.model.hand import Hand
from tests.interop.two_fingers import BELOW, PINCH, SIZE, matrix, model, on_opposite_faces, seven

pytestmark = pytest.mark.filterwarnings("ignore:GraspIt!. fields that are not used")
OBJECT = (np.array([0.3, -0.2, 0.1]), Rotation.from_euler("xyz", (0.4, -0.3, 0.9)))
PALM = (OBJECT[0] + OBJECT[1].apply(BELOW), OBJECT[1])
ORDER = ("right", "-", "left", "-")
"""As of a hand whose joints break away, so that a flag follows each number."""


def place(where: tuple[np.ndarray, Rotation]) -> str:
    x, y, z, *turn = seven(1e3 * where[0], where[1])
    full = f"({' '.join(f'{q:+.12g}' for q in turn)})[{x:+.12g} {y} {z}]"
    return f"<transform><fullTransform>{full}</fullTransform></transform>"


def world(values: str = f"{PINCH[1]:+} 0 {PINCH[0]:+} +0", robot: str = place(PALM), body: str = place(OBJECT)) -> str:
    return f"""<?xml version="1.0" ?>
    <world>
        <obstacle><filename>models/table.xml</filename></obstacle>
        <graspableBody><filename>models/objects/cube.xml</filename>{body}</graspableBody>
        <robot><filename>models/robots/Two/Two.xml</filename><dofValues>{values} </dofValues>{robot}</robot>
        <camera><position>0 0 0</position></camera>
    </world>"""


@pytest.fixture
def hand(folder) -> Hand:
    (folder / "hand.xml").write_text(model())
    return hand_from_mujoco(load_mjcf("hand.xml"), "palm").hand


def test_places_are_millimetres_and_joints_as_the_order_says(folder, hand):
    (folder / "one.xml").write_text(world())
    grasps = read_graspit("one.xml", hand, ORDER)
    np.testing.assert_allclose(grasps.transforms[0], matrix(*PALM), atol=1e-10)
    np.testing.assert_allclose(grasps.objects[0], matrix(*OBJECT), atol=1e-10)
    assert grasps.angles.tolist() == [list(PINCH)] and grasps.scales.tolist() == [1e-3]


@pytest.mark.slow
def test_forward_kinematics_puts_the_fingers_on_the_cube(folder, hand, capsys):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box([1e3 * SIZE] * 3).export("cube.stl")
    (folder / "one.xml").write_text(world())
    command = ["import", "graspit", "one.xml", "--hand", "hand.xml", "--object", "cube.stl", "--levels", "5"]
    assert main([*command, "--order", *ORDER]) == 0
    sets = load_grasps("grasps.npz")
    on_opposite_faces(sets.points, sets.normals, matrix(*OBJECT))


TWO = world().replace("<camera>", "<robot><filename>models/robots/Puma/Puma.xml</filename></robot><camera>")


@pytest.mark.parametrize(
    "text, message",
    [
        ("<world>", "bad.xml is not XML"),
        ("<robot/>", "bad.xml is <robot>: expected <world>"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><world/>', "bad.xml defines entities"),
        ("<world/>", "it has 0 <graspableBody>: expected one of any name"),
        (TWO, "it has 2 <robot>: expected one of Two, Puma"),
        (world("0 0"), "dofValues has 2 numbers: expected 4, one for each name of the order"),
        (world("0 1 0 0"), r"dofValues\[1\] is 1: expected 0, a joint that has not broken away"),
        (world("0 0 x 0"), "dofValues is 'x': expected a number"),
        (world("3 0 0 0"), "is 3, but the hand's 'right' goes from -1 to 1"),
        (world(robot="<transform><translation>0 0 0</translation></transform>"), "robot's transform is of translation"),
        (
            world(robot="<transform><fullTransform>1 0 0 0</fullTransform></transform>"),
            r"expected \(w x y z\)\[x y z\]",
        ),
        (world(body=place(OBJECT).replace("(", "(5 ")), "graspableBody's quaternion has the (length|shape)"),
        (world(body=place(OBJECT).replace("[", "[inf ")), "graspableBody's place has the shape"),
    ],
)
def test_a_bad_world_is_named(folder, hand, text, message):
    (folder / "bad.xml").write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_graspit("bad.xml", hand, ORDER)
    assert str(caught.value).startswith("bad.xml") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "order, message",
    [
        (("right", "-", "lefty", "-"), "the order has 'lefty', which the hand does not have.*'left'.*has no 'left'"),
        (("right", "-", "right", "-"), "the order names 'right' twice: expected each joint once"),
    ],
)
def test_a_bad_order_is_named_with_the_nearest(folder, hand, order, message):
    (folder / "one.xml").write_text(world())
    with pytest.raises(ValueError, match=message):
        read_graspit("one.xml", hand, order)


MODEL = """<root>
    <mass>250</mass> <cog>10 -20 5</cog> <material>rubber</material> <inertia_matrix>1 0 0 0 1 0 0 0 1</inertia_matrix>
    <geometryFile type="off">cube.off</geometryFile> <geometryScaling>2</geometryScaling>
</root>"""


@pytest.mark.parametrize("is_inline", [False, True])
def test_mass_centre_and_mesh_of_the_bodys_model_are_read(folder, hand, is_inline):
    """A model is in grams and millimetres, beside the world or in it, as GraspIt! writes bodies without a file."""
    objects = folder / "models/objects"
    (folder / "worlds").mkdir()
    objects.mkdir(parents=True)
    (objects / "cube.xml").write_text(MODEL)
    (objects / "cube.off").write_text("OFF")
    text = world()
    if is_inline:
        inline = MODEL.replace("root>", "body>").replace("cube.off", "models/objects/cube.off")
        text = text.replace("<filename>models/objects/cube.xml</filename>", inline)
    (folder / "worlds/one.xml").write_text(text)
    with pytest.warns(UserWarning, match="^GraspIt!: fields that are not used: graspableBody.material, obstacle$"):
        poses = read_graspit("worlds/one.xml", hand, ORDER)
    assert poses.mass == pytest.approx(0.25) and poses.scales.tolist() == [2e-3]
    np.testing.assert_allclose(poses.center_of_mass, [0.01, -0.02, 0.005])
    assert poses.mesh_path() == objects / "cube.off"


@pytest.mark.parametrize(
    "field, message",
    [
        ("<mass>0</mass>", "graspableBody's model's mass is 0: expected a positive number"),
        ("<mass>heavy</mass>", "graspableBody's model's mass is 'heavy'"),
        ("<cog>1 2</cog>", r"graspableBody's model's cog has the shape \(2,\): expected \(3\)"),
        (
            "<geometryScaling>-1</geometryScaling>",
            "graspableBody's model's geometryScaling is -1: expected a posi",
        ),
    ],
)
def test_a_bad_model_of_the_body_is_named(folder, hand, field, message):
    (folder / "cube.xml").write_text(f"<root>{field}</root>")
    (folder / "one.xml").write_text(world())
    with pytest.raises(ValueError, match=f"^one.xml: {message}"):
        read_graspit("one.xml", hand, ORDER)


def test_elements_that_are_not_used_are_named(folder, hand):
    """A table holds nothing here, and of a model that is not there neither weight nor friction is known."""
    (folder / "two.xml").write_text(TWO.replace("<camera>", "<connection/><camera>"))
    missing = r"mass, cog and geometry of graspableBody \(models/objects/cube.xml is not there\)"
    with pytest.warns(UserWarning, match=f"not used: connection, {missing}, obstacle, other robot$"):
        read_graspit("two.xml", hand, ORDER, robot="Two")


def test_of_several_robots_one_is_named(folder, hand):
    (folder / "two.xml").write_text(TWO)
    assert len(read_graspit("two.xml", hand, ORDER, robot="Two")) == 1
