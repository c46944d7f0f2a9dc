"""What no human hand grips, by its size, its mass, or what its joints would bear: most often another unit."""

from jaxgrasp.grip.scene_file import SceneFile

LENGTHS = (0.12, 0.25)
"""Hands, from a small child's to the largest adult's, from the wrist to the middle finger's tip [m]."""
RADII = (0.002, 0.12)
"""From a pencil lead's to a basketball's, which the largest hands hold in one [m]."""
MASSES = (0.001, 20.0)
"""[kg]"""
DEPTHS = (0.0, 0.01)
"""The pulp of a fingertip gives way by half of that at most [m]."""
TORQUE = 10.0
"""Above what the strongest finger joints give against flexion, some 5 N.m at the knuckles [N.m]."""


def beyond_human(file: SceneFile) -> list[str]:
    """A line on each size of a scene that is out of human scale."""
    entry = file.object
    radius = max(entry.size) / 2 if entry.size else entry.radius
    asked = [
        ("the hand's length", file.hand.length, LENGTHS, "m"),
        ("the object's mass", entry.mass, MASSES, "kg"),
        ("the depth to which the links press", file.grip.depth, DEPTHS, "m"),
    ]
    if entry.mesh is None:
        asked.append(("the object's radius or half its edge", radius, RADII, "m"))
    return [
        f"WARNING: {what} is {value:g} {unit}, out of human scale, {low:g} to {high:g} {unit}: is it in {unit}?"
        for what, value, (low, high), unit in asked
        if not low <= value <= high
    ]


def too_strong(torque: float) -> list[str]:
    """A line on a torque that no finger's joint gives [N.m]."""
    if torque <= TORQUE:
        return []
    return [f"WARNING: no finger's joint gives {torque:.3g} N.m, {TORQUE:g} N.m at most: are sizes in m, masses in kg?"]
