"""Bodies of GraspIt!'s worlds: mass, centre of mass and geometry, from a model's file or from the world itself.

A ``graspableBody`` names its model by ``filename``, a path below the folder of GraspIt!, or has its fields in ``body``.
A model's file in XML has ``mass`` [g], ``cog``, the centre of mass [mm], and ``geometryFile``, a path beside the model,
whose numbers times ``geometryScaling`` are millimetres; a ``filename`` that ends otherwise is that of the geometry.
``inertia_matrix`` and ``useFlockOfBirds``, a sensor's number, are not needed; a warning names whatever else there is:
``material``, by which GraspIt! looks up friction, ``youngs``, by which it makes contacts soft, and ``geometryOffset``.

Source: https://github.com/graspit-simulator/graspit, ``loadFromXml`` and ``saveToXml`` of ``Body`` and ``DynamicBody``
in ``src/body.cpp``."""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrasp.files.file_numbers import decimal_number
from jaxgrasp.files.printable import printable
from jaxgrasp.interop.bounded_xml import read_xml
from jaxgrasp.interop.file_records import LONGEST_PATH, find_named, numbers, positive

GRAM = 1e-3
MILLIMETRE = 1e-3
USED = ("mass", "cog", "geometryFile", "geometryScaling")
NOT_NEEDED = ("inertia_matrix", "useFlockOfBirds")
UNREADABLE = (".iv", ".wrl")
"""Endings of geometry in Open Inventor's formats, which no reader of meshes here knows."""


class GraspItBody(NamedTuple):
    """Properties of a body; what the files do not say is None."""

    mass: float | None = None
    """[kg]"""
    center_of_mass: np.ndarray | None = None
    """``(3,)`` in the body's frame [m]."""
    scale: float = MILLIMETRE
    """Metres for one unit of the geometry."""
    mesh: str | None = None
    """Path of the geometry, where its format can be read."""
    unused: tuple[str, ...] = ()
    """Names of fields that are not used."""


def read_body(element: ElementTree.Element, path: Path) -> GraspItBody:
    """Read a body out of its element ``graspableBody`` in the world's file ``path``.

    Raises:
        ValueError: naming the field of the body, or the file of its model, that is wrong.
        OSError: for a model's file that cannot be read.
    """
    named, inline = (element.findtext("filename") or "").strip(), element.find("body")
    if not named:
        return GraspItBody() if inline is None else _body_of_fields(inline, "graspableBody.body", path)
    if len(named) > LONGEST_PATH:
        raise ValueError(f"graspableBody's filename has {len(named)} characters: expected {LONGEST_PATH} at most")
    if Path(named).suffix.lower() != ".xml":
        return GraspItBody(mesh=_readable(named))
    model = find_named(named, 1, path)
    if model is None:
        missing = f"mass, cog and geometry of graspableBody ({printable(named)[-60:]} is not there)"
        return GraspItBody(unused=(missing,))
    return _body_of_fields(read_xml(model, "a body's model of GraspIt!"), "graspableBody's model", model)


def _body_of_fields(fields: ElementTree.Element, name: str, path: Path) -> GraspItBody:
    """Read the fields of a body; paths are relative to the file ``path``."""
    mass, scaling = (_positive(fields, tag, name) for tag in ("mass", "geometryScaling"))
    center = _numbers_of(fields, "cog", name)
    geometry = (fields.findtext("geometryFile") or "").strip()
    unused = {child.tag for child in fields} - {*USED, *NOT_NEEDED}
    return GraspItBody(
        mass=None if mass is None else GRAM * mass,
        center_of_mass=None if center is None else MILLIMETRE * numbers(f"{name}'s cog", center, (3,)),
        scale=MILLIMETRE * (1 if scaling is None else scaling),
        mesh=_readable(str(path.resolve().parent / geometry)) if 0 < len(geometry) <= LONGEST_PATH else None,
        unused=tuple(f"graspableBody.{tag}" for tag in sorted(unused)),
    )


def _numbers_of(fields: ElementTree.Element, tag: str, name: str) -> list[float] | None:
    """Read the numbers of a field; None where there is no such field."""
    text = fields.findtext(tag)
    if text is None:
        return None
    try:
        return [decimal_number(word) for word in text.split()]
    except ValueError as error:
        raise ValueError(f"{name}'s {tag} {error}") from None


def _positive(fields: ElementTree.Element, tag: str, name: str) -> float | None:
    """Read the positive number of a field; None where there is no such field."""
    values = _numbers_of(fields, tag, name)
    return None if values is None else positive(f"{name}'s {tag}", numbers(f"{name}'s {tag}", values, (1,))[0])


def _readable(path: str) -> str | None:
    return None if Path(path).suffix.lower() in UNREADABLE else path
