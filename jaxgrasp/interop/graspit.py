"""GraspIt!'s world files: a robot's hand beside a body, in millimetres.

A file in XML has a ``graspableBody`` and a ``robot``, each with the ``filename`` of its model and a ``transform`` of
one ``fullTransform`` ``(w x y z)[x y z]``, a unit quaternion and a place in the world [mm]. The robot's is that of its
palm. ``dofValues`` are its degrees of freedom [rad; mm of those that slide] in the order of the ``dof`` elements of the
robot's own model, without their names; one of the kind that breaks away writes a flag for each of its joints behind its
value, 0 where none has broken away. Joints that follow another by a factor are not in the file. Normals and forces it
has none. Mass, centre of mass and mesh of the body are those of its model's file, where that is beside the world or in
a folder above, or of the world itself (``graspit_body.py``). ``camera`` is not needed; a warning names whatever else a
world has: every ``obstacle``, such as a table, which bears nothing here, other robots, and a ``connection`` of two
robots.

The order must so be said by whoever imports: the names of a hand's joints, one for each number, and ``-`` for a flag.
Of it the limits of the joints are checked, and that each joint of the hand is named once.

Source: Miller and Allen, GraspIt!, 2004; https://github.com/graspit-simulator/graspit, ``src/world.cpp``,
``src/matvecIO.cpp`` and ``BreakAwayDOF`` in ``src/dof.cpp``.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxgrasp.files.file_numbers import decimal_number
from jaxgrasp.files.printable import shortened
from jaxgrasp.interop.file_records import (
    GraspPoses,
    by_name,
    by_order,
    frame,
    numbers,
    read_text,
    rotation,
    warn_unused,
)
from jaxgrasp.interop.graspit_body import MILLIMETRE, read_body
from jaxgrasp.model.hand import Hand
from jaxgrasp.validation.checked import checked

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
