"""What stays the same while a hand handles an object: both of them, the laws of their contacts, and the world."""

import equinox as eqx
import jax
import numpy as np

from jaxgrasp.grip.motion import Body
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import entries
from jaxgrasp.model.hand import Hand, Pose


class Obstacle(eqx.Module):
    """What stands in the object's way and never moves; without friction, as the paper's world is.

    A hand that holds the object may press it in, against springs (eq. 1); what moves by itself is stopped at once. Let
    it be thicker than twice as far as a hand presses, since contacts leave by the nearest face.
    """

    shape: Shape
    """An exact shape, or a tree."""
    placed: Pose
    stiffness: float | AnyArray
    """K of eq. 1 [N/m], of each part of the outline that touches: four, where a box stands on a plane."""


class Scene(eqx.Module):
    """A hand, an object, and the world around them."""

    hand: Hand
    body: Body
    table: Pose
    """In the world: its top is the xy plane of this frame; the half space below is solid."""
    friction: float | AnyArray
    stiffness: float | AnyArray
    """K of eq. 6 [N/m]"""
    contributions: Float[AnyArray, "L"]
    """c of eq. 6, of each link."""
    gravity: Float[AnyArray, "3"]
    """[m/s^2]"""
    guide: Float[AnyArray, "6 k"] | None = None
    """Twists (linear, angular) about the world's origin, along which alone a guide lets the object move, such as
    ``np.eye(6)[:, 2:3]`` for a vertical rail; ``None`` for an object that moves freely."""
    obstacles: tuple[Obstacle, ...] = ()
    outline: Hand | None = None
    """The object's parts that meet obstacles: ``rigid_body(sphere_tree(shape))``; needed where there are any. Its balls
    lie inside the object, so that it sinks in by what they leave out."""
    table_friction: float | AnyArray = 0.5
    """Coulomb's coefficient between the object and the table."""


def check_scene(scene: Scene) -> None:
    """Raise ValueError where a guide is none, or obstacles lack what they need; what is traced is not checked."""
    if scene.guide is not None and not isinstance(scene.guide, jax.core.Tracer):
        guide = np.asarray(scene.guide)
        if guide.ndim != 2 or guide.shape[0] != 6 or not 1 <= guide.shape[1] <= 6:
            raise ValueError(f"guide has shape {guide.shape}: expected (6, k), a column for each of 1 to 6 twists")
        for fault in entries("guide", guide, ~np.isfinite(guide), "a finite number"):
            raise ValueError(str(fault))
        if not guide.any():
            raise ValueError("guide is all zeros: expected a twist in one of its columns at least")
    _check_not_negative("table_friction", scene.table_friction, "0 or more")
    if not isinstance(scene.obstacles, tuple):
        raise ValueError(f"obstacles is a {type(scene.obstacles).__name__}: expected a tuple of Obstacles")
    for k, obstacle in enumerate(scene.obstacles):
        _check_not_negative(f"obstacles[{k}].stiffness", obstacle.stiffness, "0 or more [N/m]")
    if scene.obstacles and not isinstance(scene.outline, Hand):
        given = None if scene.outline is None else f"a {type(scene.outline).__name__}"
        raise ValueError(f"outline is {given}: with obstacles expected rigid_body(sphere_tree(shape)) of the object")


def _check_not_negative(name: str, value: AnyArray | float, expected: str) -> None:
    if isinstance(value, jax.core.Tracer):
        return
    numbers = np.asarray(value)
    for fault in entries(name, numbers, ~(np.isfinite(numbers) & (numbers >= 0)), expected):
        raise ValueError(str(fault))
