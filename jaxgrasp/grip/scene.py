"""A scene: hand, object, the laws of their contacts, table, guide and obstacles, all constant over time."""

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
from jaxgrasp.numerics.geometry import rotation_by


class ObstaclePath(eqx.Module):
    """Path of an obstacle over time: at constant speed from each point to the next, at rest before the first and after
    the last."""

    times: Float[AnyArray, "K"]
    """Ascending [s]; a scene begins at 0."""
    shifts: Float[AnyArray, "K 3"]
    """Shift of its frame's origin, along the world's axes [m]."""
    turns: Float[AnyArray, "K 3"]
    """Rotation vector about its frame's origin, along the world's axes [rad]."""

    def moved(self, placed: Pose, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time, of an obstacle that is at ``placed`` without shift or turn."""
        columns = jnp.concatenate([jnp.asarray(self.shifts), jnp.asarray(self.turns)], -1)
        pose_change = jax.vmap(lambda column: jnp.interp(time, jnp.asarray(self.times), column), 1)(columns)
        return Pose(placed.origin + pose_change[:3], rotation_by(pose_change[3:]) @ placed.rotation)


class Obstacle(eqx.Module):
    """A solid in the way of object and hand, at rest or on a prescribed path.

    To an object in the hand it is a spring (eq. 1), which moves the object in the hand. A free object is stopped at
    once. Make it thicker than twice the depth to which a hand presses: contacts are resolved through the nearest face.
    """

    shape: Shape
    """An exact shape, or a tree."""
    placed: Pose
    stiffness: float | AnyArray
    """K of eq. 1 [N/m], of each part of the outline in contact: four, where a box stands on a plane."""
    friction: float | AnyArray = 0.0
    """Coulomb's coefficient between the obstacle and the object; there is no friction with the hand."""
    damping: float | AnyArray = 0.0
    """Damping of each part of the outline as it goes deeper [N.s/m]; it never pulls."""
    path: ObstaclePath | None = None
    """Path of a moving obstacle; None for one at rest."""
    motion: Motion | None = None
    """Velocity of a moving obstacle, as set by ``at_time``."""
    touches_hand: bool = eqx.field(static=True, default=True)
    """True if the hand's own links are stopped by it; False if they pass through."""


class Scene(eqx.Module):
    """A hand, an object, and the world around them."""

    hand: Hand
    body: Body
    table: Pose
    """Pose of the table in the world: its top is the xy plane of this frame; the half space below is solid."""
    friction: float | AnyArray
    stiffness: float | AnyArray
    """K of eq. 6 [N/m]"""
    contributions: Float[AnyArray, "L"]
    """c of eq. 6, for each link."""
    gravity: Float[AnyArray, "3"]
    """[m/s^2]"""
    guide: Float[AnyArray, "6 k"] | None = None
    """Twists (linear, angular) about the world's origin that a guide leaves to the object; ``None`` for a free object.
    A vertical rail has ``np.eye(6)[:, 2:3]``."""
    obstacles: tuple[Obstacle, ...] = ()
    outline: Hand | None = None
    """Parts of the object that meet obstacles: ``rigid_body(sphere_tree(shape))``; required with obstacles. Its balls
    lie inside the object, so that it sinks in by the part that they leave out."""
    table_friction: float | AnyArray = 0.5
    """Coulomb's coefficient between the object and the table."""
    table_touches_hand: bool = eqx.field(static=True, default=False)
    """True if the hand's own links are stopped by the table; False if they pass through: fingers around an object on a
    table would be inside it."""
    torsion: float | AnyArray | None = None
    """Torsional friction of the hand's contacts with the object [m]; None for hard contacts. Contacts with table and
    obstacles are hard always."""


def at_time(scene: Scene, time: Float[AnyArray, ""] | float) -> Scene:
    """Return the scene with its obstacles at their poses and velocities at a time [s]."""
    if all(obstacle.path is None for obstacle in scene.obstacles):
        return scene
    return eqx.tree_at(
        lambda s: s.obstacles, scene, tuple(_obstacle_at(obstacle, time) for obstacle in scene.obstacles)
    )


def obstacles_at_time(scene: Scene, time: float) -> tuple[Obstacle, ...]:
    """Return the obstacles of a scene at their poses and velocities at a time [s]; moving ones as NumPy arrays."""
    if all(obstacle.path is None for obstacle in scene.obstacles):
        return scene.obstacles
    return jax.device_get(_obstacles_at(scene.obstacles, time))


@jax.jit
def _obstacles_at(obstacles: tuple[Obstacle, ...], time: AnyArray | float) -> tuple[Obstacle, ...]:
    return tuple(_obstacle_at(obstacle, time) for obstacle in obstacles)


def _obstacle_at(obstacle: Obstacle, time: Float[AnyArray, ""] | float) -> Obstacle:
    """Return an obstacle at its pose and velocity at a time [s]."""
    if (path := obstacle.path) is None:
        return obstacle
    instant = jnp.asarray(time, float)
    pose, rate = jax.jvp(lambda t: path.moved(obstacle.placed, t), (instant,), (jnp.ones_like(instant),))
    spin = rate.rotation @ pose.rotation.T
    motion = Motion(rate.origin, jnp.array([spin[2, 1], spin[0, 2], spin[1, 0]]))
    # Without its path: evaluated at another time, the shift would be applied twice.
    return replace(obstacle, placed=pose, motion=motion, path=None)


def check_scene(scene: Scene) -> None:
    """Raise ValueError for an invalid guide, and for obstacles without the object's outline; traced values are not
    checked."""
    if scene.guide is not None and not isinstance(scene.guide, jax.core.Tracer):
        guide = np.asarray(scene.guide)
        if guide.ndim != 2 or guide.shape[0] != 6 or not 1 <= guide.shape[1] <= 6:
            raise ValueError(f"guide has shape {guide.shape}: expected (6, k), a column for each of 1 to 6 twists")
        for issue in entries("guide", guide, ~np.isfinite(guide), "a finite number"):
            raise ValueError(str(issue))
        if not guide.any():
            raise ValueError("guide is all zeros: expected a nonzero twist in at least one column")
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
        outline = None if scene.outline is None else f"a {type(scene.outline).__name__}"
        raise ValueError(
            f"outline is {outline}: expected rigid_body(sphere_tree(shape)) of the object where there are obstacles"
        )


def _check_ascending(name: str, times: np.ndarray) -> None:
    if not (len(times) > 0 and np.all(np.isfinite(times)) and np.all(np.diff(times) > 0)):
        raise ValueError(f"{name} is {times.tolist()}: expected ascending times [s]")


def _check_not_negative(name: str, value: AnyArray | float, expected: str) -> None:
    if isinstance(value, jax.core.Tracer):
        return
    numbers = np.asarray(value)
    for issue in entries(name, numbers, ~(np.isfinite(numbers) & (numbers >= 0)), expected):
        raise ValueError(str(issue))
