"""GraspIt!'s world files: a robot's hand beside a body with mass, centre of mass and mesh, in millimetres.

A file in XML has a ``graspableBody`` and a ``robot``, each with the ``filename`` of its model and a ``transform`` of
one ``fullTransform`` ``(w x y z)[x y z]``, a unit quaternion and a place in the world [mm]. The robot's is that of its
palm. ``dofValues`` are its degrees of freedom [rad; mm of those that slide] in the order of the ``dof`` elements of the
robot's own model, without their names; one of the kind that breaks away writes a flag for each of its joints behind its
value, 0 where none has broken away. Joints that follow another by a factor are not in the file. Normals and forces it
has none. Mass, centre of mass and mesh of the body are those of its model's file, where that is beside the world or in
a folder above, or of the world itself. ``camera`` is not needed; a warning names whatever else a world has: every
``obstacle``, such as a table, which bears nothing here, other robots, and a ``connection`` of two robots.

The order must so be said by whoever imports: the names of a hand's joints, one for each number, and ``-`` for a flag.
Of it the limits of the joints are checked, and that each joint of the hand is named once.

A ``graspableBody`` names its model by ``filename``, a path below the folder of GraspIt!, or has its fields in ``body``.
A model's file in XML has ``mass`` [g], ``cog``, the centre of mass [mm], and ``geometryFile``, a path beside the model,
whose numbers times ``geometryScaling`` are millimetres; a ``filename`` that ends otherwise is that of the geometry.
``inertia_matrix`` and ``useFlockOfBirds``, a sensor's number, are not needed; a warning names whatever else there is:
``material``, by which GraspIt! looks up friction, ``youngs``, by which it makes contacts soft, and ``geometryOffset``.

Source: Miller and Allen, GraspIt!, 2004; https://github.com/graspit-simulator/graspit, ``src/world.cpp``,
``src/matvecIO.cpp``, ``BreakAwayDOF`` in ``src/dof.cpp``, and ``loadFromXml`` and ``saveToXml`` of ``Body`` and
``DynamicBody`` in ``src/body.cpp``.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrasp.files.file_values import decimal_number
from jaxgrasp.files.printable import printable, shortened
from jaxgrasp.interop.file_records import (
    LONGEST_PATH,
    GraspPoses,
    by_name,
    by_order,
    find_named,
    frame,
    numbers,
    positive,
    read_text,
    rotation,
    warn_unused,
)
from jaxgrasp.interop.model_file import read_xml
from jaxgrasp.model.hand import Hand
from jaxgrasp.validation.checked import checked

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


FLAG = "-"
TRANSFORM = re.compile(r"\s*\(([^()]*)\)\s*\[([^\[\]]*)\]\s*")


@checked
def read_graspit(path: str | Path, hand: Hand, order: Sequence[str], *, robot: str | None = None) -> GraspPoses:
    """Read the grasp of a GraspIt! world file.

    Args:
        path: an ``.xml`` file.
        hand: whose wrist is the palm of the robot's model.
        order: the hand's joint that each number of ``dofValues`` is of, and ``-`` for those that are none.
        robot: which of several robots is the hand, by the name of its model's file without its ending.

    Returns:
        One pose in the world, where the body stands too, with the body's mass, centre of mass and mesh, where its model
        says so; the scale is that of meshes in millimetres, times the model's own. The mesh is None where it is in Open
        Inventor's formats, or where the model is not there.

    Warns:
        UserWarning: naming elements and fields that are not used.

    Raises:
        ValueError: for a file that is no such world, naming the element that is wrong.
        OSError: for a file that cannot be read.
    """
    root = _root(path)
    try:
        element, chosen = _only(root, "graspableBody", None), _only(root, "robot", robot)
        body = read_body(element, Path(path))
        poses = GraspPoses(
            Path(path),
            ("0",),
            _read_transform(chosen, "robot")[None],
            _angles(chosen, hand, order)[None],
            np.array([body.scale]),
            _read_transform(element, "graspableBody")[None],
            body.mesh,
            mass=body.mass,
            center_of_mass=body.center_of_mass,
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    warn_unused("GraspIt!", [*_unused(root, element, chosen), *body.unused], ("camera",))
    return poses


def _root(path: str | Path) -> ElementTree.Element:
    text = read_text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError(f"{path} defines entities: expected a world of GraspIt!, which has none")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not XML: {error}") from None
    if root.tag != "world":
        raise ValueError(f"{path} is <{root.tag[:40]}>: expected <world>, a world of GraspIt!")
    return root


def _unused(root: ElementTree.Element, *used: ElementTree.Element) -> list[str]:
    """Return names of the elements of a world that are not read, and of the fields of those that are."""
    names = [f"other {child.tag}" if child.tag == "robot" else child.tag for child in root if child not in used]
    fields = ("filename", "transform", "dofValues", "body")
    return names + [f"{element.tag}.{child.tag}" for element in used for child in element if child.tag not in fields]


def _only(root: ElementTree.Element, tag: str, name: str | None) -> ElementTree.Element:
    """Return the only element with a tag, or the one of that tag whose model file has a name."""
    elements = root.findall(tag)
    stems = [Path(_text(element, "filename") or "").stem for element in elements]
    if name is not None:
        elements = [element for element, stem in zip(elements, stems, strict=True) if stem == name]
    if len(elements) != 1:
        more = f" of the name {name!r}" if name is not None else ""
        raise ValueError(f"it has {len(elements)} <{tag}>{more}: expected one of {', '.join(stems) or 'any name'}")
    return elements[0]


def _text(element: ElementTree.Element, tag: str) -> str | None:
    text = element.findtext(tag)
    return None if text is None else text.strip()


def _read_transform(element: ElementTree.Element, name: str) -> np.ndarray:
    """Read the transform ``(4, 4)`` [m] of an element."""
    parts = element.findall("transform/*")
    if len(parts) != 1 or parts[0].tag != "fullTransform":
        tags = ", ".join(part.tag[:40] for part in parts) or "none"
        raise ValueError(f"{name}'s transform is of {tags}: expected one fullTransform")
    written = TRANSFORM.fullmatch(parts[0].text or "")
    if written is None:
        raise ValueError(f"{name}'s fullTransform is {shortened(parts[0].text)}: expected (w x y z)[x y z]")
    turn, origin = (_numbers(f"{name}'s fullTransform", text) for text in written.groups())
    return frame(MILLIMETRE * numbers(f"{name}'s place", origin, (3,)), rotation(f"{name}'s quaternion", turn))


def _numbers(name: str, text: str) -> list[float]:
    try:
        return [decimal_number(word) for word in text.split()]
    except ValueError as error:
        raise ValueError(f"{name} {error}") from None


def _angles(robot: ElementTree.Element, hand: Hand, order: Sequence[str]) -> np.ndarray:
    values = _numbers("dofValues", _text(robot, "dofValues") or "")
    if len(values) != len(order):
        raise ValueError(f"dofValues has {len(values)} numbers: expected {len(order)}, one for each name of the order")
    broken = [k for k, name in enumerate(order) if name == FLAG and values[k] != 0]
    if broken:
        raise ValueError(
            f"dofValues[{broken[0]}] is {values[broken[0]]:g}: expected 0, a joint that has not broken away"
        )
    named = [name for name in order if name != FLAG]
    if len(set(named)) < len(named):
        raise ValueError(
            f"the order names {next(n for n in named if named.count(n) > 1)!r} twice: expected each joint once"
        )
    by_joint = {name: value for name, value in zip(order, values, strict=True) if name != FLAG}
    angles = by_name(by_joint, hand.joints, "the order")
    return by_order("dofValues", np.where(hand.slides, MILLIMETRE, 1.0) * angles, hand)
