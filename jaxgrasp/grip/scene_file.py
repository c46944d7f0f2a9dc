"""A scene in a TOML file: a hand, what it grips and how, what that stands on, meets and is guided by, and the world."""

import os
from dataclasses import dataclass, field, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrasp.files.toml_fields import load_toml, made_from, nearest
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
from jaxgrasp.hand.balanced_contributions import balanced_contributions
from jaxgrasp.hand.closing_way import ClosingWay, closing_way
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.finger_names import name_fingers
from jaxgrasp.hand.grip_type import GripType, contributions_of, grip_type
from jaxgrasp.hand.human_hand import human_hand
from jaxgrasp.hand.shapes import Shape, Shifted
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.world import rigid_body, world_contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.validation.checked import checked

Entry = TypeVar("Entry")
LONGEST_NAME = 200
APART = 1e-5
"""How deep an obstacle may be in the object at first [m]: rounding."""


@dataclass(frozen=True)
class SceneFile:
    """What a file says; what it leaves out is the cylinder of ``jaxgrasp glove run``."""

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
        """What each table says, by its name; what is not given is left out."""
        named = {name: getattr(self, name) for name in (*TABLES, "guide")}
        for kind in ("obstacle", "other"):
            named |= {f"{kind}[{k}]": entry for k, entry in enumerate(getattr(self, kind))}
        said = {name: vars(entry).items() for name, entry in named.items() if entry is not None}
        return {name: {key: value for key, value in entry if value is not None} for name, entry in said.items()}


class GrippedScene(NamedTuple):
    """A scene, and how its hand and object stand at first."""

    scene: Scene
    closed: Posture
    open: Float[AnyArray, "J"]
    """Angles of the open hand [rad]."""
    placed: Pose
    """Where the object's centre of mass is, and its axes."""
    contacts: Contacts
    kind: GripType
    law: Law


TABLES = {"hand": HandEntry, "object": ObjectEntry, "grip": GripEntry, "table": TableEntry, "world": WorldEntry}


def ready_scenes() -> dict[str, Path]:
    """The files that come with the package, by their names."""
    folder = Path(str(files("jaxgrasp").joinpath("data", "scenes")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def scene_path(given: str) -> Path:
    """The file that a name or a path means.

    Raises:
        ValueError: for what is neither a file nor the name of a ready scene.
    """
    ready = ready_scenes()
    if given in ready and not Path(given).is_file():
        return ready[given]
    # A link that leads nowhere, or in a loop, is a file: reading it names the cause.
    if not os.path.lexists(given):
        raise ValueError(f"scene is {given!r}: expected a TOML file, or one of {', '.join(ready)}")
    return Path(given)


@checked
def load_scene(path: str | os.PathLike) -> SceneFile:
    """The scene in a TOML file.

    Raises:
        ValueError: for a file that is no TOML, keys that are unknown, and values that no scene has, by table and key.
        OSError: for a file that cannot be read.
    """
    given = load_toml(Path(path))
    known = [one.name for one in fields(SceneFile)]
    for key in given:
        if key not in known:
            raise ValueError(f"{path} has {key!r}{nearest(key, known)}")
    name = given.get("name", SceneFile.name)
    if not isinstance(name, str):
        raise ValueError(f"name is {name!r}: expected text")
    if len(name) > LONGEST_NAME:
        raise ValueError(f"name has {len(name)} characters: expected {LONGEST_NAME} at most")
    found = SceneFile(
        name,
        **{key: made_from(kind, given.get(key, {}), key) for key, kind in TABLES.items()},
        guide=made_from(GuideEntry, given["guide"], "guide") if "guide" in given else None,
        obstacle=_each(ObstacleEntry, given, "obstacle"),
        other=_each(OtherEntry, given, "other"),
    )
    folder = Path(path).parent
    mesh, hand = (
        _existing(*one, folder) for one in (("object.mesh", found.object.mesh), ("hand.file", found.hand.file))
    )
    others = tuple(
        replace(entry, mesh=_existing(f"other[{k}].mesh", entry.mesh, folder)) for k, entry in enumerate(found.other)
    )
    return replace(found, object=replace(found.object, mesh=mesh), hand=replace(found.hand, file=hand), other=others)


def _each(kind: type[Entry], given: dict[str, Any], name: str) -> tuple[Entry, ...]:
    """The entries of an array of tables; none where it is not given."""
    tables = given.get(name, [])
    if not isinstance(tables, list):
        raise ValueError(f"{name} is {tables!r}: expected tables [[{name}]]")
    return tuple(made_from(kind, one, f"{name}[{k}]") for k, one in enumerate(tables))


def _existing(name: str, given: str | None, folder: Path) -> str | None:
    """Path of a file that an entry names, if it names one."""
    if given is None:
        return None
    path = folder / given
    try:
        there = path.is_file()
    except OSError:
        there = False
    if not there:
        raise ValueError(f"{name} is {given[:80]!r}: there is no such file")
    return str(path)


@checked
def gripped_scene(file: SceneFile, hand: Hand | None = None) -> GrippedScene:
    """The hand closed on the object, which stands on the table.

    Args:
        file: what the scene is.
        hand: the one in the file that the scene names; a human one where it names none.

    Raises:
        ValueError: for a mesh that is no closed surface, a hand without palm and fingers, an object that the hand
            cannot grip so, and an obstacle that begins inside the object.
        ImportError: for a mesh without the extra `mesh`.
    """
    if (hand is None) != (file.hand.file is None):
        raise ValueError(f"hand is {'None' if hand is None else 'given'}: expected the one in {file.hand.file!r}")
    if hand is None:
        hand = human_hand(file.hand.length, file.hand.breadth, file.hand.side)
    else:
        hand = name_fingers(hand, file.hand.names())
    way = closing_way(hand, open=file.hand.open, closed=file.hand.closed)
    body, centre = file.object.body()
    closed, placed, contacts = _closed(file.grip, hand, body.shape, way)
    kind = GripType(int(grip_type(hand, closed, contacts)))
    contributions = contributions_of(hand, kind)
    if file.grip.contributions == "balanced":
        contributions = balanced_contributions(contacts, contributions, placed.origin)
    origin = jnp.asarray(placed.origin)
    placed = Pose(origin, jnp.asarray(placed.rotation))
    obstacles, outline = _in_the_way(file, body.shape, placed)
    ground = Pose(jnp.zeros(3), jnp.eye(3))
    top = height_above(ground, body.shape, placed) - file.table.below
    if centre.any():
        body, placed, outline = _about(centre, body, placed, outline)
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
    return GrippedScene(scene, closed, jnp.asarray(way.open), placed, contacts, kind, file.grip.law)


def _about(centre: np.ndarray, body: Body, placed: Pose, outline: Hand | None) -> tuple[Body, Pose, Hand | None]:
    """An object whose frame's origin is its centre of mass, where that is given in the frame that it had."""
    there = Pose(placed.origin + placed.rotation @ centre, placed.rotation)
    shifted = Body(Shifted(body.shape, *(-centre).tolist()), body.mass, body.inertia)
    if outline is not None:
        outline = eqx.tree_at(lambda hand: hand.skin.centers, outline, outline.skin.centers - centre)
    return shifted, there, outline


def _in_the_way(file: SceneFile, shape: Shape, placed: Pose) -> tuple[tuple[Obstacle, ...], Hand | None]:
    """The obstacles in the world, and the object's outline that meets them; none where there are none."""
    if not file.obstacle:
        return (), None
    outline = rigid_body(shape if isinstance(shape, SphereTree) else sphere_tree(shape))
    found = []
    for k, entry in enumerate(file.obstacle):
        at = Pose(placed.origin + jnp.array(entry.at), entry.rotation())
        solid = entry.solid()
        inside = float(jnp.max(world_contacts(outline, placed, solid, at).depths))
        if inside > APART:
            raise ValueError(f"obstacle[{k}] begins {1000 * inside:.3g} mm deep in the object: expected it outside")
        laws = (entry.stiffness, entry.friction, entry.damping)
        found.append(Obstacle(solid, at, *laws, entry.moves(), touches_hand=entry.touches_hand))
    return tuple(found), outline


def _closed(grip: GripEntry, hand: Hand, shape: Shape, way: ClosingWay) -> tuple[Posture, Pose, Contacts]:
    if grip.kind == "power":
        return power_grip(hand, shape, grip.depth, way)
    return precision_grip(hand, shape, int(grip.kind.removeprefix("precision-")), grip.depth, way)
