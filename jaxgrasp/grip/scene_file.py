"""A scene in a TOML file: a hand, its object and grip, and table, obstacles, guide and world around them."""

import os
from dataclasses import dataclass, field, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrasp.files.file_values import build_dataclass, load_toml, nearest
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.motion import Body, height_above
from jaxgrasp.grip.power_grip import power_grip
from jaxgrasp.grip.precision_grip import precision_grip
from jaxgrasp.grip.scene import Obstacle, Scene
from jaxgrasp.grip.scene_entries import (
    GripEntry,
    GuideEntry,
    HandEntry,
    ObjectEntry,
    ObstacleEntry,
    OtherEntry,
    TableEntry,
    WorldEntry,
)
from jaxgrasp.hand.closing import ClosingKinematics, closing_kinematics, name_fingers
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.human_hand import human_hand
from jaxgrasp.hand.shapes import Shape, Shifted
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import GripType, balanced_contributions, contributions_of, grip_type
from jaxgrasp.hand.world import rigid_body, world_contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.validation.checked import checked

Entry = TypeVar("Entry")
LONGEST_NAME = 200
APART = 1e-5
"""Tolerance for an obstacle's depth in the object at the start [m]: rounding."""
LENGTHS = (0.12, 0.25)
"""Lengths of hands, from a small child's to the largest adult's, from the wrist to the middle finger's tip [m]."""
RADII = (0.002, 0.12)
"""Radii of objects, from a pencil lead's to a basketball's, which the largest hands hold [m]."""
MASSES = (0.001, 20.0)
"""[kg]"""
DEPTHS = (0.0, 0.01)
"""Depths of contacts: the pulp of a fingertip yields by at most half of that [m]."""
TORQUE = 10.0
"""Torque above the strength of finger joints in flexion, some 5 N.m at the knuckles [N.m]."""


@dataclass(frozen=True)
class SceneFile:
    """Contents of a scene file; defaults are the cylinder of ``jaxgrasp glove run``."""

    name: str = "a cylinder on a table"
    hand: HandEntry = field(default_factory=HandEntry)
    object: ObjectEntry = field(default_factory=ObjectEntry)
    grip: GripEntry = field(default_factory=GripEntry)
    table: TableEntry = field(default_factory=TableEntry)
    world: WorldEntry = field(default_factory=WorldEntry)
    guide: GuideEntry | None = None
    obstacle: tuple[ObstacleEntry, ...] = ()
    other: tuple[OtherEntry, ...] = ()

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the fields of each table, by its name, without those that are not set."""
        entries = {name: getattr(self, name) for name in (*TABLES, "guide")}
        for key in ("obstacle", "other"):
            entries |= {f"{key}[{k}]": entry for k, entry in enumerate(getattr(self, key))}
        fields_by_table = {name: vars(entry).items() for name, entry in entries.items() if entry is not None}
        return {
            name: {key: value for key, value in entry if value is not None} for name, entry in fields_by_table.items()
        }


class GrippedScene(NamedTuple):
    """A scene with the initial posture of its hand and pose of its object."""

    scene: Scene
    closed: Posture
    open: Float[AnyArray, "J"]
    """Angles of the open hand [rad]."""
    placed: Pose
    """Position of the object's centre of mass, and its axes."""
    contacts: Contacts
    kind: GripType
    law: Law


TABLES = {"hand": HandEntry, "object": ObjectEntry, "grip": GripEntry, "table": TableEntry, "world": WorldEntry}


def ready_scenes() -> dict[str, Path]:
    """Return the scene files of the package, by name."""
    folder = Path(str(files("jaxgrasp").joinpath("data", "scenes")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def scene_path(name_or_path: str) -> Path:
    """Find the scene file for a name or a path.

    Raises:
        ValueError: for a name that is neither a file nor a ready scene.
    """
    ready = ready_scenes()
    if name_or_path in ready and not Path(name_or_path).is_file():
        return ready[name_or_path]
    # A link that leads nowhere, or in a loop, is a file: reading it names the cause.
    if not os.path.lexists(name_or_path):
        raise ValueError(f"scene is {name_or_path!r}: expected a TOML file, or one of {', '.join(ready)}")
    return Path(name_or_path)


@checked
def load_scene(path: str | os.PathLike) -> SceneFile:
    """Read a scene from a TOML file.

    Raises:
        ValueError: for a file that is not TOML, unknown keys, and invalid values, by table and key.
        OSError: for a file that cannot be read.
    """
    contents = load_toml(Path(path))
    field_names = [entry.name for entry in fields(SceneFile)]
    for key in contents:
        if key not in field_names:
            raise ValueError(f"{path} has {key!r}{nearest(key, field_names)}")
    name = contents.get("name", SceneFile.name)
    if not isinstance(name, str):
        raise ValueError(f"name is {name!r}: expected text")
    if len(name) > LONGEST_NAME:
        raise ValueError(f"name has {len(name)} characters: expected at most {LONGEST_NAME}")
    scene = SceneFile(
        name,
        **{key: build_dataclass(entry_type, contents.get(key, {}), key) for key, entry_type in TABLES.items()},
        guide=build_dataclass(GuideEntry, contents["guide"], "guide") if "guide" in contents else None,
        obstacle=_entries(ObstacleEntry, contents, "obstacle"),
        other=_entries(OtherEntry, contents, "other"),
    )
    folder = Path(path).parent
    mesh, hand = (
        _existing_path(*entry, folder) for entry in (("object.mesh", scene.object.mesh), ("hand.file", scene.hand.file))
    )
    other_entries = tuple(
        replace(entry, mesh=_existing_path(f"other[{k}].mesh", entry.mesh, folder))
        for k, entry in enumerate(scene.other)
    )
    return replace(
        scene, object=replace(scene.object, mesh=mesh), hand=replace(scene.hand, file=hand), other=other_entries
    )


def _entries(entry_type: type[Entry], contents: dict[str, Any], name: str) -> tuple[Entry, ...]:
    """Read the entries of an array of tables; none where it is absent."""
    tables = contents.get(name, [])
    if not isinstance(tables, list):
        raise ValueError(f"{name} is {tables!r}: expected tables [[{name}]]")
    return tuple(build_dataclass(entry_type, table, f"{name}[{k}]") for k, table in enumerate(tables))


def _existing_path(name: str, file_name: str | None, folder: Path) -> str | None:
    """Return the path of a file that an entry names, or None; raise ValueError if it does not exist."""
    if file_name is None:
        return None
    path = folder / file_name
    try:
        is_present = path.is_file()
    except OSError:
        is_present = False
    if not is_present:
        raise ValueError(f"{name} is {file_name[:80]!r}: there is no such file")
    return str(path)


@checked
def gripped_scene(file: SceneFile, hand: Hand | None = None) -> GrippedScene:
    """Close the hand on the object, which stands on the table.

    Args:
        file: contents of the scene file.
        hand: hand from the file that the scene names; None for a human hand.

    Raises:
        ValueError: for a mesh that is not a closed surface, a hand without palm and fingers, an object that the hand
            cannot grip, and an obstacle that begins inside the object.
        ImportError: for a mesh without the extra `mesh`.
    """
    if (hand is None) != (file.hand.file is None):
        raise ValueError(f"hand is {'None' if hand is None else 'given'}: expected the one in {file.hand.file!r}")
    if hand is None:
        hand = human_hand(file.hand.length, file.hand.breadth, file.hand.side)
    else:
        hand = name_fingers(hand, file.hand.names())
    closing = closing_kinematics(hand, open=file.hand.open, closed=file.hand.closed)
    body, centre = file.object.body()
    closed, placed, contacts = _close_hand(file.grip, hand, body.shape, closing)
    kind = GripType(int(grip_type(hand, closed, contacts)))
    contributions = contributions_of(hand, kind)
    if file.grip.contributions == "balanced":
        contributions = balanced_contributions(contacts, contributions, placed.origin)
    origin = jnp.asarray(placed.origin)
    placed = Pose(origin, jnp.asarray(placed.rotation))
    obstacles, outline = _obstacles(file, body.shape, placed)
    ground = Pose(jnp.zeros(3), jnp.eye(3))
    top = height_above(ground, body.shape, placed) - file.table.below
    if centre.any():
        body, placed, outline = _about_centre_of_mass(centre, body, placed, outline)
    scene = Scene(
        hand=hand,
        body=body,
        table=Pose(origin.at[2].set(top), jnp.eye(3)),
        friction=file.object.friction,
        stiffness=file.object.stiffness,
        contributions=contributions,
        gravity=jnp.array(file.world.gravity),
        guide=None if file.guide is None else jnp.asarray(file.guide.twists(np.asarray(origin))),
        obstacles=obstacles,
        outline=outline,
        table_friction=file.table.friction,
        table_touches_hand=file.table.touches_hand,
        torsion=file.object.torsion or None,
    )
    return GrippedScene(scene, closed, jnp.asarray(closing.open), placed, contacts, kind, file.grip.law)


def _about_centre_of_mass(
    centre: np.ndarray, body: Body, placed: Pose, outline: Hand | None
) -> tuple[Body, Pose, Hand | None]:
    """Move the frame of an object to its centre of mass, which is given in the former frame."""
    shifted_pose = Pose(placed.origin + placed.rotation @ centre, placed.rotation)
    shifted = Body(Shifted(body.shape, *(-centre).tolist()), body.mass, body.inertia)
    if outline is not None:
        outline = eqx.tree_at(lambda hand: hand.skin.centers, outline, outline.skin.centers - centre)
    return shifted, shifted_pose, outline


def _obstacles(file: SceneFile, shape: Shape, placed: Pose) -> tuple[tuple[Obstacle, ...], Hand | None]:
    """Build the obstacles in the world, and the outline of the object; nothing where there are none."""
    if not file.obstacle:
        return (), None
    outline = rigid_body(shape if isinstance(shape, SphereTree) else sphere_tree(shape))
    obstacles = []
    for k, entry in enumerate(file.obstacle):
        at = Pose(placed.origin + jnp.array(entry.at), entry.rotation())
        solid = entry.solid()
        inside = float(jnp.max(world_contacts(outline, placed, solid, at).depths))
        if inside > APART:
            raise ValueError(f"obstacle[{k}] begins {1000 * inside:.3g} mm deep in the object: expected it outside")
        laws = (entry.stiffness, entry.friction, entry.damping)
        obstacles.append(Obstacle(solid, at, *laws, entry.moves(), touches_hand=entry.touches_hand))
    return tuple(obstacles), outline


def _close_hand(
    grip: GripEntry, hand: Hand, shape: Shape, closing: ClosingKinematics
) -> tuple[Posture, Pose, Contacts]:
    if grip.kind == "power":
        return power_grip(hand, shape, grip.depth, closing)
    return precision_grip(hand, shape, int(grip.kind.removeprefix("precision-")), grip.depth, closing)


def human_scale_warnings(file: SceneFile) -> list[str]:
    """Return a warning for each size of a scene that is out of human scale."""
    entry = file.object
    radius = max(entry.size) / 2 if entry.size else entry.radius
    sizes = [
        ("the hand's length", file.hand.length, LENGTHS, "m"),
        ("the object's mass", entry.mass, MASSES, "kg"),
        ("the depth to which the links press", file.grip.depth, DEPTHS, "m"),
    ]
    if entry.mesh is None:
        sizes.append(("the object's radius or half its edge", radius, RADII, "m"))
    return [
        f"WARNING: {quantity} is {value:g} {unit}, out of human scale, {low:g} to {high:g} {unit}: is it in {unit}?"
        for quantity, value, (low, high), unit in sizes
        if not low <= value <= high
    ]


def torque_warnings(torque: float) -> list[str]:
    """Return a warning for a torque above the strength of finger joints [N.m]."""
    if torque <= TORQUE:
        return []
    return [
        f"WARNING: the largest joint torque is {torque:.3g} N.m, and finger joints bear at most {TORQUE:g} N.m: "
        "check that sizes are in m and masses in kg"
    ]
