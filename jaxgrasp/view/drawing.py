"""Conversion of a grasp's solution to poses, sizes and colours of a drawing, independent of the program that
draws."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.grip.monitor import Touch
from jaxgrasp.report.grasp_in_3d import round_up
from jaxgrasp.report.look import METHOD_COLOURS, MUTED, TOUCH_COLOURS, WRENCH_COLOUR
from jaxgrasp.report.stage import Scale
from jaxgrasp.view.instances import Arrows, Instances, arrows, cones, dots, rgb
from jaxgrasp.view.seen import SolvedGrasp

CONE, DOT = 0.016, 0.0021
"""Side of a friction cone, radius of a contact [m]."""
LONG, LONGEST, SHORTEST = 0.045, 0.07, 0.012
"""Initial length of the largest arrow, and its longest and shortest length before the scale changes [m]."""
LENGTH = 0.01
"""Length that the stated scale refers to [m]."""
LOAD = 0.05
"""Length of the load's arrow, independent of its force [m]."""
TOUCHES = np.array([rgb(TOUCH_COLOURS.get(touch, MUTED)) for touch in Touch], np.uint8)
"""Colours of contacts by what they do."""


class Drawing(NamedTuple):
    """Poses, contacts, cones and arrows that are drawn at an instant."""

    links: np.ndarray | None
    """Poses of the hand's links ``(L, 3, 4)``; None where there is no hand."""
    object_pose: np.ndarray
    """``(3, 4)``"""
    moving: np.ndarray
    """Poses of further objects and of obstacles that move ``(M, 3, 4)``."""
    contacts: Instances
    cones: Instances
    forces: dict[str, Arrows]
    """Force arrows by the method's name."""
    load: Arrows
    """Arrow of the external force on the object."""
    scale: Scale
    origin: np.ndarray
    """Centre of the object's rotation when it escapes ``(3,)`` [m]."""


def drawing(solved: SolvedGrasp, scale: Scale | None = None, size: float = 1.0) -> Drawing:
    """Compute the drawing of a grasp.

    Args:
        seen: the grasp.
        scale: of the previous drawing's arrows, which is kept while it is legible.
        size: of contacts, cones and arrows, relative to those beside a human hand.
    """
    forces = {name: solved.forces(answer) for name, answer, _ in solved.answers()}
    scale = fitting(scale, forces, size)
    colours = TOUCHES[solved.touches]
    points, normals, touching = solved.points, np.asarray(solved.grasp.normals), solved.touching
    return Drawing(
        links=None if solved.hand is None else solved.hand.links,
        object_pose=solved.object_pose,
        moving=solved.moving,
        contacts=dots(points, touching, DOT * size, colours),
        cones=cones(points, normals, np.asarray(solved.grasp.friction), touching, CONE * size, colours),
        forces={
            name: arrows(points, scale.metres * force, METHOD_COLOURS[name], size) for name, force in forces.items()
        },
        load=_load(solved, size),
        scale=scale,
        origin=np.asarray(solved.origin, float),
    )


def drawn_points(drawn: Drawing) -> np.ndarray:
    """Return points ``(P, 3)`` [m] that a picture of the contacts and arrows has to contain: contacts, tails and tips
    of all visible arrows, and the middles of the cones' rims.
    """
    ends = [drawn.contacts.visible_positions(), drawn.cones.visible_ends()]
    for each in (*drawn.forces.values(), drawn.load):
        ends += [each.shafts.visible_positions(), each.heads.visible_ends()]
    return np.concatenate(ends)


def fitting(scale: Scale | None, forces: dict[str, np.ndarray], size: float = 1.0) -> Scale:
    """Return the previous scale if it draws the largest force [N] at a legible length, else a new round scale."""
    largest = max(float(np.linalg.norm(force, axis=-1).max(initial=0)) for force in forces.values())
    if scale is not None and (largest == 0 or SHORTEST * size <= scale.metres * largest <= LONGEST * size):
        return scale
    length = round_up(LENGTH * size)
    return Scale(length, round_up(largest * length / (LONG * size)))


def _load(solved: SolvedGrasp, size: float) -> Arrows:
    """Return an arrow along the load: the opposite of the force that the contacts must exert."""
    force = -np.asarray(solved.wrench[:3], float)
    newtons = float(np.linalg.norm(force))
    vector = force * (LOAD * size / newtons) if newtons > 0 else force
    return arrows(middle(solved)[None], vector[None], WRENCH_COLOUR, size)


def middle(solved: SolvedGrasp) -> np.ndarray:
    """Return the tail of the load's arrow ``(3,)`` [m]: the object's centre with a hand, else the contacts' mean."""
    touching = solved.touching
    if solved.hand is not None or not touching.any():
        return np.asarray(solved.object_pose[:, 3], float)
    return solved.points[touching].mean(0)
