"""``jaxgrasp scene`` and ``jaxgrasp hand``: what a scene's or a hand's file holds, and ready scenes."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from jaxgrasp.cli.arguments import Check, CheckHand, ReadyScenes
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.printable import printable
from jaxgrasp.grip.scene_file import load_scene, ready_scenes, scene_path
from jaxgrasp.interop.hand_file import USED, HandFile, JointEntry, read_hand


def check_hand_command(arguments: CheckHand) -> int:
    """Show what a file holds; 1 where shapes are missing without which no reader takes it, 0 otherwise."""
    read = read_hand(arguments.file, arguments.wrist, keep_going=True)
    show(f"{read.format}, wrist {printable(read.wrist)}")
    for lines in (_joints(read), _links(read)):
        for line in _aligned(lines):
            show(line)
    missing = [note for note in read.left_out if note.missing]
    for title, notes in (("left out or changed", set(read.left_out) - set(missing)), ("missing", missing)):
        for note in (entry for entry in read.left_out if entry in notes):
            show(f"{title}: {printable(note)}")
    used = sum(joint.use.startswith(USED) for joint in read.joints)
    show(f"{used} of {len(read.joints)} joints used, {len(read.links)} links can touch, {len(missing)} meshes missing")
    return int(bool(missing) and read.format == "URDF")


def _joints(read: HandFile) -> Iterator[Sequence[str]]:
    yield "joint", "kind", "from", "to", "torque", "use"
    for joint in read.joints:
        yield printable(joint.name), joint.kind, *_numbers(joint), joint.use


def _numbers(joint: JointEntry) -> tuple[str, str, str]:
    """Format lower limit, upper limit and largest torque of a joint, with their units."""
    position_unit, effort_unit = ("m", "N") if joint.kind == "slide" else ("rad", "N.m")
    low, high = (
        ("no limit", "")
        if joint.limits is None
        else (f"{joint.limits[0]:.4g}", f"{joint.limits[1]:.4g} {position_unit}")
    )
    return low, high, f"{joint.torque_max:.4g} {effort_unit}" if np.isfinite(joint.torque_max) else "not known"


def _links(read: HandFile) -> Iterator[Sequence[str]]:
    yield "link", "shapes", "spheres"
    for link in read.links:
        counts = Counter(link.shapes)
        shapes = ", ".join(f"{count} {shape}" if count > 1 else shape for shape, count in counts.items())
        yield printable(link.name), shapes, str(link.spheres)


def _aligned(lines: Iterator[Sequence[str]]) -> Iterator[str]:
    """Yield a line for each row, with columns padded to equal width."""
    rows = list(lines)
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def check_scene_command(arguments: Check) -> int:
    """Say what a scene holds; whatever is wrong with it is raised."""
    scene = load_scene(scene_path(arguments.scene))
    show(scene.name)
    for table, entries in scene.tables().items():
        show(f"  {table}: " + ", ".join(f"{key} {value}" for key, value in entries.items()))
    return 0


def list_command(arguments: ReadyScenes) -> int:
    """Print name and title of each scene that ships with the package."""
    for name, path in ready_scenes().items():
        show(f"{name:12s} {load_scene(path).name}")
    return 0
