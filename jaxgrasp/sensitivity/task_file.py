"""Tasks of sensitivity analyses: in a TOML file, as contacts on an object and its path, and the paper's own."""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.files.file_values import build_dataclass, load_toml, nearest
from jaxgrasp.model.task import GRAVITY, Held, HeldCylinder, HeldObject, Lift, Shake, Task, Turn, carrying
from jaxgrasp.validation.checked import (
    check_directions,
    check_finite,
    check_not_negative,
    check_positive,
    check_vectors,
    checked,
)

Numbers = tuple[float, ...]
BY_CONTACT = ("friction", "contributions", "stiffness", "depths")
FINGERS = ("thumb", "index", "middle", "ring", "little")
RADIUS, WEIGHT, SPEED = 0.05, 10.0, float(np.pi)
"""Values of the paper: 5 cm, 10 N, and pi rad/s one way, then the other."""
INDEX_CONTRIBUTIONS = (0.02, 0.1, 0.4)
"""Three values of the index's contribution, as in Fig. 5, which does not give them."""
PAPER_GRAVITY = 9.81


class NamedTask(NamedTuple):
    """A task, and the names of its contacts."""

    task: Task
    fingers: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _HeldEntry:
    """Common fields of held objects; a number for each contact."""

    friction: Numbers
    contributions: Numbers
    stiffness: Numbers
    """[N/m]"""
    depths: Numbers
    """[m]"""
    mass: float
    """[kg]"""
    center_of_mass: Numbers = (0.0, 0.0, 0.0)
    """[m]"""

    def __post_init__(self) -> None:
        check_positive(self, "mass")
        check_vectors(self, "center_of_mass")
        for name in BY_CONTACT:
            for k, value in enumerate(getattr(self, name)):
                if not (np.isfinite(value) and value >= 0):
                    raise ValueError(f"{name}[{k}] is {value}: expected a number, zero or more")

    def arrays(self) -> dict[str, Any]:
        """Return the numbers as arguments of the model."""
        numbers = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "kind"}
        return {name: jnp.array(value) if isinstance(value, tuple) else value for name, value in numbers.items()}


@dataclass(frozen=True, kw_only=True)
class CylinderEntry(_HeldEntry):
    """Table ``[held]`` of a cylinder about its z axis, held at its side."""

    kind: Literal["cylinder"] = "cylinder"
    radius: float
    """[m]"""
    length: float
    """[m]"""
    azimuths: Numbers
    """[rad]"""
    heights: Numbers
    """[m]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "radius", "length")

    def build(self) -> HeldObject:
        """Build the object with its contacts."""
        return HeldCylinder(**self.arrays())


@dataclass(frozen=True, kw_only=True)
class PointsEntry(_HeldEntry):
    """Table ``[held]`` of any rigid object, by the points of its contacts."""

    kind: Literal["points"] = "points"
    points: tuple[Numbers, ...]
    """[m]"""
    normals: tuple[Numbers, ...]
    """Directions into the object; of any length."""
    inertia: tuple[Numbers, ...]
    """Inertia tensor about the centre of mass, three rows [kg.m^2]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("points", "normals", "inertia"):
            for k, row in enumerate(getattr(self, name)):
                if len(row) != 3 or not np.all(np.isfinite(row)):
                    raise ValueError(f"{name}[{k}] is {list(row)}: expected three finite numbers")
        for k, normal in enumerate(self.normals):
            if not any(normal):
                raise ValueError(f"normals[{k}] is all zeros: expected a direction")
        inertia = np.array(self.inertia)
        if inertia.shape != (3, 3) or not np.allclose(inertia, inertia.T) or np.linalg.eigvalsh(inertia)[0] < 0:
            raise ValueError("inertia is not a symmetric, positive semidefinite matrix of three rows")

    def build(self) -> HeldObject:
        """Build the object with its contacts."""
        return Held(**self.arrays())


@dataclass(frozen=True, kw_only=True)
class TurnEntry:
    """Table ``[path]`` of a turn about an axis through the origin."""

    kind: Literal["turn"] = "turn"
    axis: Numbers
    speed: float
    """[rad/s]"""
    reversal: float | None = None
    """Duration of the motion one way before it reverses [s]."""

    def __post_init__(self) -> None:
        check_directions(self, "axis")
        check_finite(self, "speed")
        check_positive(self, "reversal")

    def build(self) -> Turn:
        """Build the path."""
        return Turn(jnp.array(self.axis), self.speed, self.reversal)


@dataclass(frozen=True, kw_only=True)
class LiftEntry:
    """Table ``[path]`` of a lift from rest to rest."""

    kind: Literal["lift"] = "lift"
    direction: Numbers = (0.0, 0.0, 1.0)
    height: float
    """[m]"""
    duration: float
    """[s]"""

    def __post_init__(self) -> None:
        check_directions(self, "direction")
        check_finite(self, "height")
        check_positive(self, "duration")

    def build(self) -> Lift:
        """Build the path."""
        return Lift(jnp.array(self.direction), self.height, self.duration)


@dataclass(frozen=True, kw_only=True)
class ShakeEntry:
    """Table ``[path]`` of shaking to and fro."""

    kind: Literal["shake"] = "shake"
    direction: Numbers
    amplitude: float
    """[m]"""
    frequency: float
    """[Hz]"""

    def __post_init__(self) -> None:
        check_directions(self, "direction")
        check_not_negative(self, "amplitude", "frequency")

    def build(self) -> Shake:
        """Build the path."""
        return Shake(jnp.array(self.direction), self.amplitude, self.frequency)


HELD: dict[str, Any] = {"cylinder": CylinderEntry, "points": PointsEntry}
PATHS: dict[str, Any] = {"turn": TurnEntry, "lift": LiftEntry, "shake": ShakeEntry}


@checked
def load_task(path: str | os.PathLike) -> NamedTask:
    """Read a task from a TOML file with ``fingers``, ``gravity``, and the tables ``[held]`` and ``[path]``.

    Raises:
        ValueError: for a file that is not TOML, unknown or missing keys, and invalid values, by name.
        OSError: for a file that cannot be read.
    """
    contents = load_toml(Path(path))
    keys = ("fingers", "gravity", "held", "path")
    for key in contents:
        if key not in keys:
            raise ValueError(f"{path} has {key!r}{nearest(key, keys)}")
    held, path_entry = (_entry(name, contents.get(name), kinds) for name, kinds in (("held", HELD), ("path", PATHS)))
    fingers = contents.get("fingers")
    is_list_of_names = isinstance(fingers, list) and all(isinstance(name, str) and name for name in fingers)
    if not is_list_of_names or not fingers or len(set(fingers)) < len(fingers):
        raise ValueError(f"fingers is {fingers!r}: expected a list of names, a different one for each contact")
    by_contact = ("azimuths", "heights") if isinstance(held, CylinderEntry) else ("points", "normals")
    for name in (*by_contact, *BY_CONTACT):
        if len(getattr(held, name)) != len(fingers):
            raise ValueError(f"held.{name} has {len(getattr(held, name))} entries: expected {len(fingers)}, as fingers")
    gravity = contents.get("gravity", list(GRAVITY))
    if not (isinstance(gravity, list) and len(gravity) == 3 and all(isinstance(g, int | float) for g in gravity)):
        raise ValueError(f"gravity is {gravity!r}: expected three numbers [m/s^2]")
    return NamedTask(carrying(held.build(), path_entry.build(), gravity=jnp.array(gravity, float)), tuple(fingers))


def _entry(name: str, table: Any, kinds: dict[str, Any]) -> Any:
    if not isinstance(table, dict):
        raise ValueError(f"{name} is {table!r}: expected a table")
    kind = table.get("kind")
    if kind not in kinds:
        raise ValueError(f"{name}.kind is {kind!r}{nearest(str(kind), list(kinds))}")
    return build_dataclass(kinds[kind], table, name)


@checked
def cylinder_task() -> Task:
    """Build the paper's task: five fingertips turn a cylinder about its own, level axis, two seconds one way, two
    seconds back.

    The paper gives the number of contacts, the radius, the weight and the angular speed. Chosen here are the places
    (four fingers side by side, 2 cm apart, the thumb opposite), the contributions (a weak index; the thumb's the sum of
    the others'), stiffness, depths and friction, the axis, the start (the fingers below), and the time of reversal.
    With these method A pulls at the index about as long as the paper says it is unstable.
    """
    held = HeldCylinder(
        radius=RADIUS,
        length=0.15,
        azimuths=jnp.array([jnp.pi, 0.0, 0.0, 0.0, 0.0]),
        heights=jnp.array([0.0, 0.03, 0.01, -0.01, -0.03]),
        friction=jnp.full(5, 0.5),
        contributions=jnp.array([3.1, 0.1, 1.0, 1.0, 1.0]),
        stiffness=jnp.full(5, 1000.0),
        depths=jnp.full(5, 2.5e-3),
        mass=WEIGHT / PAPER_GRAVITY,
        center_of_mass=jnp.zeros(3),
    )
    turn = Turn(axis=jnp.array([0.0, 0.0, 1.0]), speed=SPEED, reversal=2.0)
    return carrying(held, turn, gravity=jnp.array([PAPER_GRAVITY, 0.0, 0.0]))
