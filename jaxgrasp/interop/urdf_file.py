"""A URDF file as it is before MuJoCo reads it: faults that have a name, and parts that a Hand does not need.

MuJoCo refuses a whole file for the inertia of one link, and says neither that a file is a xacro nor which name is there
twice. A Hand has no inertia, and needs of a link no more than what touches.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxgrasp.files.printable import printable, shortened
from jaxgrasp.interop.bounded_xml import how_to_expand, read_xml
from jaxgrasp.interop.left_out import LeftOut

KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MOST_LINKS = 2_000
"""So many take MuJoCo two seconds, and the time grows with the third power."""
SIZES = {"sphere": ("radius",), "box": ("size",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}
"""Shapes of URDF, and the attributes that have to be positive."""
INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def read_urdf(path: Path) -> ElementTree.Element:
    """Return the ``robot`` element of a URDF file whose links and joints make a tree.

    Raises:
        ValueError: for a file that is no URDF or is not there, a xacro, a name that two links or two joints have, a
            joint of an unknown type or without its links, and a link that hangs on two others or on itself.
        OSError: for a file that cannot be read.
    """
    robot = read_xml(path, "a URDF file")
    if robot.tag != "robot":
        raise ValueError(
            f"path is {str(path)!r}: expected a URDF file, whose root is <robot>, not <{printable(robot.tag)[:80]}>"
        )
    try:
        _check_expanded(robot, path)
        _check_names(robot)
        _check_tree(robot)
    except ValueError as error:
        raise ValueError(f"path is {str(path)!r}: {error}") from None
    return robot


def _check_expanded(robot: ElementTree.Element, path: Path) -> None:
    for element in robot.iter():
        namespace, _, tag = element.tag.rpartition("}")
        if "xacro" in namespace:
            raise ValueError(f"it has the element <xacro:{printable(tag)[:80]}>: {how_to_expand(path)}")
        for key, value in element.attrib.items():
            if "${" in value or "$(" in value:
                raise ValueError(f"<{element.tag}> has {key}={shortened(value)}: {how_to_expand(path)}")


def _check_names(robot: ElementTree.Element) -> None:
    for tag in ("link", "joint"):
        elements = robot.findall(tag)
        if len(elements) > MOST_LINKS:
            raise ValueError(f"it has {len(elements):,} {tag}s: expected at most {MOST_LINKS:,}")
        for name, count in Counter(element.get("name") for element in elements).items():
            if name is None:
                raise ValueError(f"it has a {tag} without a name: expected one for each")
            if count > 1:
                raise ValueError(f"{count} {tag}s have the name {shortened(name)}: expected different names")


def _check_tree(robot: ElementTree.Element) -> None:
    links = {link.get("name") for link in robot.iterfind("link")}
    parents: dict[str, str] = {}
    for joint in robot.iterfind("joint"):
        name = shortened(joint.get("name"))
        if joint.get("type") not in KINDS:
            raise ValueError(f"joint {name} has the type {joint.get('type')!r}: expected one of {', '.join(KINDS)}")
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise ValueError(f"joint {name} has the {end} {shortened(link)}: expected the name of a link")
            ends[end] = str(link)
        if ends["child"] in parents:
            raise ValueError(f"joint {name} has the child {ends['child']!r}, which hangs on another joint already")
        parents[ends["child"]] = ends["parent"]
    rooted = links - parents.keys()
    for link in parents:
        trail = [link]
        while trail[-1] not in rooted:
            trail.append(parents[trail[-1]])
            if len(trail) > len(links):
                raise ValueError(f"link {trail[-1]!r} hangs on itself: expected a tree of links")
        rooted.update(trail)


def drop_impossible_inertias(robot: ElementTree.Element) -> Iterator[LeftOut]:
    """Take out masses and inertias that no body can have, and name them: MuJoCo then makes its own of the shapes."""
    for link in robot.iterfind("link"):
        for inertial in link.findall("inertial"):
            fault = _inertia_fault(inertial)
            if fault:
                link.remove(inertial)
                yield LeftOut(
                    f"inertia of link {link.get('name', '')!r}", f"{fault}: a Hand needs none, the model's is made up"
                )


def _inertia_fault(inertial: ElementTree.Element) -> str | None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None:
        return "it has no mass"
    try:
        value = float(mass.get("value", ""))
        entries = [0.0] * 6 if inertia is None else [float(inertia.get(key, "")) for key in INERTIA]
    except ValueError:
        return "one of its entries is not a number"
    if not np.isfinite([value, *entries]).all():
        return "one of its entries is not a finite number"
    if value < 0:
        return f"the mass is {value:g} kg"
    xx, yy, zz, xy, xz, yz = entries
    least = float(np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))[0])
    # MuJoCo raises what rounding makes slightly negative, such as zero inertias.
    return f"its least principal moment is {least:.3g} kg m^2" if least < -1e-12 else None


def drop_impossible_shapes(robot: ElementTree.Element, keep_going: bool) -> Iterator[LeftOut]:
    """Check sizes of shapes; with ``keep_going`` take out those that have no volume, and name them.

    Raises:
        ValueError: for the first such shape unless ``keep_going``.
    """
    for link in robot.iterfind("link"):
        for collision in link.findall("collision"):
            for shape in collision.iterfind("geometry/*"):
                fault = _size_fault(shape)
                if fault:
                    part = f"{shape.tag} of link {link.get('name', '')!r}"
                    leave_out(link, collision, LeftOut(part, fault, missing=True), keep_going)
                    yield LeftOut(part, fault, missing=True)
                    break


def _size_fault(shape: ElementTree.Element) -> str | None:
    for key in SIZES.get(shape.tag, ()):
        text = shape.get(key, "")
        try:
            sizes = [float(word) for word in text.split()]
        except ValueError:
            sizes = []
        if not sizes or not all(np.isfinite(size) and size > 0 for size in sizes):
            return f"its {key} is {shortened(text)}: expected positive numbers [m]"
    return None


def leave_out(link: ElementTree.Element, collision: ElementTree.Element, note: LeftOut, keep_going: bool) -> None:
    """Take a shape out of its link, or raise ValueError unless ``keep_going``."""
    if not keep_going:
        raise ValueError(f"{note}; keep_going=True leaves it out")
    link.remove(collision)
