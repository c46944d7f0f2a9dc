"""A task in a TOML file: contacts that hold an object, and the path along which it is led."""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.files.toml_fields import load_toml, made_from, nearest
from jaxgrasp.model.held import Held, HeldCylinder, HeldObject
from jaxgrasp.model.paths import Lift, Shake, Turn
from jaxgrasp.model.task import GRAVITY, Task, carrying
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.fields import check_directions, check_finite, check_not_negative, check_positive, check_vectors

Numbers = tuple[float, ...]
BY_CONTACT = ("friction", "contributions", "stiffness", "depths")


class NamedTask(NamedTuple):
    """A task, and what its contacts are called."""

    task: Task
    fingers: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _HeldEntry:
    """What all held objects say; one number for each contact."""

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
        """Its numbers as the model's."""
        given = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "kind"}
        return {name: jnp.array(value) if isinstance(value, tuple) else value for name, value in given.items()}


@dataclass(frozen=True, kw_only=True)
class CylinderEntry(_HeldEntry):
    """The table ``[held]`` of a cylinder about its z axis, held at its side."""

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

    def made(self) -> HeldObject:
        """The object with its contacts."""
        return HeldCylinder(**self.arrays())


@dataclass(frozen=True, kw_only=True)
class PointsEntry(_HeldEntry):
    """The table ``[held]`` of any rigid object, by the places of its contacts."""

    kind: Literal["points"] = "points"
    points: tuple[Numbers, ...]
    """[m]"""
    normals: tuple[Numbers, ...]
    """Into the object; of any length."""
    inertia: tuple[Numbers, ...]
    """Three rows, about the centre of mass [kg.m^2]."""

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
            raise ValueError("inertia is no symmetric matrix of three rows without negative moments")

    def made(self) -> HeldObject:
        """The object with its contacts."""
        return Held(**self.arrays())


@dataclass(frozen=True, kw_only=True)
class TurnEntry:
    """The table ``[path]`` of a turn about an axis through the origin."""

    kind: Literal["turn"] = "turn"
    axis: Numbers
    speed: float
    """[rad/s]"""
    reversal: float | None = None
    """How long it goes one way before it goes the other [s]."""

    def __post_init__(self) -> None:
        check_directions(self, "axis")
        check_finite(self, "speed")
        check_positive(self, "reversal")

    def made(self) -> Turn:
        """The path."""
        return Turn(jnp.array(self.axis), self.speed, self.reversal)


@dataclass(frozen=True, kw_only=True)
class LiftEntry:
    """The table ``[path]`` of a lift from rest to rest."""

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

    def made(self) -> Lift:
        """The path."""
        return Lift(jnp.array(self.direction), self.height, self.duration)


@dataclass(frozen=True, kw_only=True)
class ShakeEntry:
    """The table ``[path]`` of shaking to and fro."""

    kind: Literal["shake"] = "shake"
    direction: Numbers
    amplitude: float
    """[m]"""
    frequency: float
    """[Hz]"""

    def __post_init__(self) -> None:
        check_directions(self, "direction")
        check_not_negative(self, "amplitude", "frequency")

    def made(self) -> Shake:
        """The path."""
        return Shake(jnp.array(self.direction), self.amplitude, self.frequency)


HELD: dict[str, Any] = {"cylinder": CylinderEntry, "points": PointsEntry}
PATHS: dict[str, Any] = {"turn": TurnEntry, "lift": LiftEntry, "shake": ShakeEntry}


@checked
def load_task(path: str | os.PathLike) -> NamedTask:
    """The task in a TOML file of ``fingers``, ``gravity``, and the tables ``[held]`` and ``[path]``, each of a kind.

    Raises:
        ValueError: for a file that is no TOML, keys that are unknown or missing, and values that no task has, by name.
        OSError: for a file that cannot be read.
    """
    given = load_toml(Path(path))
    known = ("fingers", "gravity", "held", "path")
    for key in given:
        if key not in known:
            raise ValueError(f"{path} has {key!r}{nearest(key, known)}")
    held, way = (_entry(name, given.get(name), kinds) for name, kinds in (("held", HELD), ("path", PATHS)))
    fingers = given.get("fingers")
    texts = isinstance(fingers, list) and all(isinstance(one, str) and one for one in fingers)
    if not texts or not fingers or len(set(fingers)) < len(fingers):
        raise ValueError(f"fingers is {fingers!r}: expected a list of names, a different one for each contact")
    by_contact = ("azimuths", "heights") if isinstance(held, CylinderEntry) else ("points", "normals")
    for name in (*by_contact, *BY_CONTACT):
        if len(getattr(held, name)) != len(fingers):
            raise ValueError(f"held.{name} has {len(getattr(held, name))} entries: expected {len(fingers)}, as fingers")
    gravity = given.get("gravity", list(GRAVITY))
    if not (isinstance(gravity, list) and len(gravity) == 3 and all(isinstance(g, int | float) for g in gravity)):
        raise ValueError(f"gravity is {gravity!r}: expected three numbers [m/s^2]")
    return NamedTask(carrying(held.made(), way.made(), gravity=jnp.array(gravity, float)), tuple(fingers))


def _entry(name: str, table: Any, kinds: dict[str, Any]) -> Any:
    if not isinstance(table, dict):
        raise ValueError(f"{name} is {table!r}: expected a table")
    kind = table.get("kind")
    if kind not in kinds:
        raise ValueError(f"{name}.kind is {kind!r}{nearest(str(kind), list(kinds))}")
    return made_from(kinds[kind], table, name)
