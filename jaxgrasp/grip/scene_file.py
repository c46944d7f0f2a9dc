"""A scene in a TOML file: a hand, what it grips and how, the table that this stands on, and the world."""

import math
import os
from dataclasses import dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Literal, NamedTuple

import jax.numpy as jnp

from jaxgrasp.files.toml_fields import load_toml, made_from, nearest
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.motion import Body, height_above
from jaxgrasp.grip.power_grip import power_grip
from jaxgrasp.grip.precision_grip import precision_grip
from jaxgrasp.grip.scene import Scene
from jaxgrasp.hand.balanced_contributions import balanced_contributions
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.grip_type import GripType, contributions_of, grip_type
from jaxgrasp.hand.human_hand import LENGTH, human_hand
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere, check_shape
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.model.task import GRAVITY
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.fields import check_not_negative, check_positive


@dataclass(frozen=True)
class HandEntry:
    """The table ``[hand]``: a human hand by its sizes."""

    length: float = LENGTH
    """From the wrist to the middle finger's tip [m]."""
    breadth: float | None = None
    """Across the knuckles [m]; in proportion where not given."""
    side: Literal["right", "left"] = "right"

    def __post_init__(self) -> None:
        check_positive(self, "length", "breadth")


@dataclass(frozen=True)
class ObjectEntry:
    """The table ``[object]``: a solid of uniform density."""

    shape: Literal["cylinder", "sphere", "capsule", "box"] = "cylinder"
    radius: float = 0.03
    """[m]; of a box half the edge."""
    height: float = 0.12
    """Of a cylinder, of a capsule's straight part, or of a box [m]."""
    mass: float = 0.15
    """[kg]"""
    friction: float = 0.6
    """Coulomb's coefficient between hand and object."""
    stiffness: float = 400.0
    """K of eq. 6 [N/m]."""

    def __post_init__(self) -> None:
        check_positive(self, "radius", "height", "mass")
        check_not_negative(self, "friction", "stiffness")

    def solid(self) -> Shape:
        """The object's shape."""
        if self.shape == "sphere":
            return Sphere(self.radius)
        if self.shape == "box":
            return Box(2 * self.radius, 2 * self.radius, self.height)
        return (Cylinder if self.shape == "cylinder" else Capsule)(self.radius, self.height)


@dataclass(frozen=True)
class GripEntry:
    """The table ``[grip]``: how the hand is closed at first."""

    kind: Literal["power", "precision-3", "precision-4", "precision-5"] = "power"
    """All of the hand, or as many fingertips."""
    depth: float = 1e-3
    """How far the links press into the object [m]."""
    contributions: Literal["table", "balanced"] = "table"
    """Of the links: the paper's Table I, or the nearest to it by which the squeezing forces balance."""
    law: Law = "optimum"
    """Which forces the hand applies."""

    def __post_init__(self) -> None:
        check_positive(self, "depth")


@dataclass(frozen=True)
class TableEntry:
    """The table ``[table]``: what the object stands on at first."""

    below: float = 0.0
    """How far below the object's lowest place it is [m]."""
    friction: float = 0.5
    """Coulomb's coefficient between object and table."""

    def __post_init__(self) -> None:
        check_not_negative(self, "below", "friction")


@dataclass(frozen=True)
class WorldEntry:
    """The table ``[world]``."""

    gravity: tuple[float, ...] = tuple(GRAVITY)
    """[m/s^2]"""

    def __post_init__(self) -> None:
        if len(self.gravity) != 3 or not all(map(math.isfinite, self.gravity)):
            raise ValueError(f"gravity is {list(self.gravity)}: expected three finite numbers [m/s^2]")


@dataclass(frozen=True)
class SceneFile:
    """What a file says; what it leaves out is the cylinder of ``jaxgrasp glove run``."""

    name: str = "a cylinder on a table"
    hand: HandEntry = field(default_factory=HandEntry)
    object: ObjectEntry = field(default_factory=ObjectEntry)
    grip: GripEntry = field(default_factory=GripEntry)
    table: TableEntry = field(default_factory=TableEntry)
    world: WorldEntry = field(default_factory=WorldEntry)


class GrippedScene(NamedTuple):
    """A scene, and how its hand and object stand at first."""

    scene: Scene
    closed: Posture
    placed: Pose
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
    if not Path(given).exists():
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
    found = SceneFile(name, **{key: made_from(kind, given.get(key, {}), key) for key, kind in TABLES.items()})
    check_shape(found.object.solid())
    return found


@checked
def gripped_scene(file: SceneFile) -> GrippedScene:
    """The hand closed on the object, which stands on the table.

    Raises:
        ValueError: for an object that the hand cannot grip so.
    """
    hand, shape = human_hand(file.hand.length, file.hand.breadth, file.hand.side), file.object.solid()
    closed, placed, contacts = _closed(file.grip, hand, shape)
    kind = GripType(int(grip_type(hand, closed, contacts)))
    contributions = contributions_of(hand, kind)
    if file.grip.contributions == "balanced":
        contributions = balanced_contributions(contacts, contributions, placed.origin)
    origin = jnp.asarray(placed.origin)
    placed = Pose(origin, jnp.asarray(placed.rotation))
    ground = Pose(jnp.zeros(3), jnp.eye(3))
    top = height_above(ground, shape, placed) - file.table.below
    scene = Scene(
        hand=hand,
        body=Body(shape, file.object.mass),
        table=Pose(origin.at[2].set(top), jnp.eye(3)),
        friction=file.object.friction,
        stiffness=file.object.stiffness,
        contributions=contributions,
        gravity=jnp.array(file.world.gravity),
        table_friction=file.table.friction,
    )
    return GrippedScene(scene, closed, placed, contacts, kind, file.grip.law)


def _closed(grip: GripEntry, hand: Hand, shape: Shape) -> tuple[Posture, Pose, Contacts]:
    if grip.kind == "power":
        return power_grip(hand, shape, grip.depth)
    return precision_grip(hand, shape, int(grip.kind.removeprefix("precision-")), grip.depth)
