"""What stays the same while a hand handles an object: both of them, the laws of their contacts, and the world."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.motion import Body, Motion
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import entries
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.numerics.rotation import rotation_by


class ObstaclePath(eqx.Module):
    """Where an obstacle is over time: at a steady speed from each place to the next, at rest before the first and after
    the last."""

    times: Float[AnyArray, "K"]
    """Ascending [s]; a scene begins at 0."""
    shifts: Float[AnyArray, "K 3"]
    """Way of its frame's origin, along the world's axes [m]."""
    turns: Float[AnyArray, "K 3"]
    """About its frame's origin: an axis in the world, as long as the angle [rad]."""

    def moved(self, placed: Pose, time: Float[AnyArray, ""] | float) -> Pose:
        """Where it is at a time, if ``placed`` without any shift or turn."""
        each = jnp.concatenate([jnp.asarray(self.shifts), jnp.asarray(self.turns)], -1)
        there = jax.vmap(lambda way: jnp.interp(time, jnp.asarray(self.times), way), 1)(each)
        return Pose(placed.origin + there[:3], rotation_by(there[3:]) @ placed.rotation)


class Obstacle(eqx.Module):
    """What stands in the way of object and hand, or moves there along a path whatever it meets.

    A hand that holds the object may press it in, against springs (eq. 1); what moves by itself is stopped at once. Let
    it be thicker than twice as far as a hand presses, since contacts leave by the nearest face.
    """

    shape: Shape
    """An exact shape, or a tree."""
    placed: Pose
    stiffness: float | AnyArray
    """K of eq. 1 [N/m], of each part of the outline that touches: four, where a box stands on a plane."""
    friction: float | AnyArray = 0.0
    """Coulomb's coefficient between it and an object that a hand holds; what moves by itself slides along it freely, as
    all does in the paper's world. It rubs against sliding, and holds nothing that rests: in full above a few mm/s."""
    damping: float | AnyArray = 0.0
    """By which each part of the outline is resisted as it goes deeper [N.s/m]; it never pulls."""
    path: ObstaclePath | None = None
    """Where it goes; it stays where not given."""
    motion: Motion | None = None
    """How it moves, of one that moves: as ``at_time`` finds it."""
    touches_hand: bool = eqx.field(static=True, default=True)
    """Whether the hand's own links are stopped by it, or go through."""


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
    table_touches_hand: bool = eqx.field(static=True, default=False)
    """Whether the hand's own links are stopped by the table, or go through: fingers around what lies on a table would
    be in it."""
    torsion: float | AnyArray | None = None
    """Torsional friction of the hand's contacts with the object [m]; all are hard where not given. Table and obstacles
    are hard always."""


def at_time(scene: Scene, time: Float[AnyArray, ""] | float) -> Scene:
    """The scene with its obstacles where they are at a time, and as they move [s]."""
    if all(obstacle.path is None for obstacle in scene.obstacles):
        return scene
    return eqx.tree_at(lambda s: s.obstacles, scene, tuple(_obstacle_at(one, time) for one in scene.obstacles))


def obstacles_now(scene: Scene, time: float) -> tuple[Obstacle, ...]:
    """The obstacles of a scene where they are at a time, and as they move [s]; of those that move in NumPy."""
    if all(obstacle.path is None for obstacle in scene.obstacles):
        return scene.obstacles
    return jax.device_get(_obstacles_at(scene.obstacles, time))


@jax.jit
def _obstacles_at(obstacles: tuple[Obstacle, ...], time: AnyArray | float) -> tuple[Obstacle, ...]:
    return tuple(_obstacle_at(one, time) for one in obstacles)


def _obstacle_at(obstacle: Obstacle, time: Float[AnyArray, ""] | float) -> Obstacle:
    """An obstacle where it is at a time, and as it moves [s]."""
    if (path := obstacle.path) is None:
        return obstacle
    now = jnp.asarray(time, float)
    there, going = jax.jvp(lambda when: path.moved(obstacle.placed, when), (now,), (jnp.ones_like(now),))
    spin = going.rotation @ there.rotation.T
    motion = Motion(going.origin, jnp.array([spin[2, 1], spin[0, 2], spin[1, 0]]))
    # It is there: asked for another time, it would go the way once more.
    return replace(obstacle, placed=there, motion=motion, path=None)


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
    if scene.torsion is not None:
        _check_not_negative("torsion", scene.torsion, "0 or more [m]")
    if not isinstance(scene.obstacles, tuple):
        raise ValueError(f"obstacles is a {type(scene.obstacles).__name__}: expected a tuple of Obstacles")
    for k, obstacle in enumerate(scene.obstacles):
        for name, unit in (("stiffness", " [N/m]"), ("friction", ""), ("damping", " [N.s/m]")):
            _check_not_negative(f"obstacles[{k}].{name}", getattr(obstacle, name), f"0 or more{unit}")
        if obstacle.path is not None and not isinstance(obstacle.path.times, jax.core.Tracer):
            _check_ascending(f"obstacles[{k}].path.times", np.asarray(obstacle.path.times))
    if scene.obstacles and not isinstance(scene.outline, Hand):
        given = None if scene.outline is None else f"a {type(scene.outline).__name__}"
        raise ValueError(f"outline is {given}: with obstacles expected rigid_body(sphere_tree(shape)) of the object")


def _check_ascending(name: str, times: np.ndarray) -> None:
    if not (len(times) > 0 and np.all(np.isfinite(times)) and np.all(np.diff(times) > 0)):
        raise ValueError(f"{name} is {times.tolist()}: expected ascending times [s]")


def _check_not_negative(name: str, value: AnyArray | float, expected: str) -> None:
    if isinstance(value, jax.core.Tracer):
        return
    numbers = np.asarray(value)
    for fault in entries(name, numbers, ~(np.isfinite(numbers) & (numbers >= 0)), expected):
        raise ValueError(str(fault))
