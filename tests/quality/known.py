"""Grasps of known quality, and random ones, that the tests of this folder share."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull

from jaxgrasp import Grasp
from jaxgrasp.testing import problems as P


def grasp_of(points, normals, friction, torsion=None) -> Grasp:
    points, normals = np.asarray(points, float), np.asarray(normals, float)
    shape = points.shape[:-1]
    wide = [None if a is None else np.broadcast_to(np.asarray(a, float), shape).copy() for a in (friction, torsion)]
    return Grasp(points, normals, wide[0], np.ones(shape), None, wide[1])


def star(angles_degrees, friction, radius: float = 0.05, torsion=None) -> Grasp:
    """Return contacts on a circle in the xy plane, whose normals meet in its middle."""
    angles = np.radians(angles_degrees)
    outward = np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    return grasp_of(radius * outward, -outward, friction, torsion)


def triangle(friction: float = 0.5) -> Grasp:
    return star([0, 120, 240], friction)


def on_axes(friction: float) -> Grasp:
    """Return six contacts where the axes leave a ball."""
    outward = np.concatenate([np.eye(3), -np.eye(3)])
    return grasp_of(0.05 * outward, -outward, friction)


def two_fingers(torsion: float | None) -> Grasp:
    return star([0, 180], 0.5, torsion=torsion)


def ordinary(n: int, count: int, seed: int = 1, torsion: bool = False) -> Grasp:
    problem = P.problems("ordinary", n, count, seed)
    twist = np.random.default_rng(seed).uniform(0.002, 0.02, problem.friction.shape) if torsion else None
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, None, twist)


def turned(grasp: Grasp, seed: int = 3) -> tuple[Grasp, np.ndarray]:
    """Return the grasp in a turned frame, and the rotation."""
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    rotation = rotation * np.sign(np.linalg.det(rotation))
    return changed(grasp, points=grasp.points @ rotation.T, normals=grasp.normals @ rotation.T), rotation


def changed(grasp: Grasp, **fields) -> Grasp:
    names = ("points", "normals", "friction", "squeeze", "present", "torsion")
    return Grasp(*(fields.get(name, getattr(grasp, name)) for name in names))


def padded(grasp: Grasp, seed: int = 4) -> Grasp:
    """Put an absent contact with invalid data in front of the others."""
    n = grasp.friction.shape[-1]
    present = np.broadcast_to(np.arange(n + 1) > 0, (*grasp.friction.shape[:-1], n + 1)).astype(float)

    def widen(array):
        if array is None:
            return None
        axis = len(grasp.friction.shape) - 1
        return np.insert(np.asarray(array), 0, np.nan, axis=axis)

    names = ("points", "normals", "friction", "squeeze")
    return Grasp(*(widen(getattr(grasp, name)) for name in names), present, widen(grasp.torsion))


def generators(grasp: Grasp, length: float, about, sides: int, outside: bool = False) -> np.ndarray:
    """Compute wrenches ``(n, sides, 6)`` of pyramids' edges, inside the cones or around them, independently."""
    arms = (np.asarray(grasp.points) - about) / length
    normals = np.asarray(grasp.normals)
    first = np.cross(normals, [0.36, 0.48, 0.8])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(normals, first)
    angles = 2 * np.pi * np.arange(sides) / sides
    reach = np.asarray(grasp.friction) / (np.cos(np.pi / sides) if outside else 1)
    across = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    forces = normals[:, None] + reach[:, None, None] * across
    return np.concatenate([forces, np.cross(arms[:, None], forces)], -1)


def pyramid_edges(grasp: Grasp, sides: int, length: float | None = None, about=None) -> np.ndarray:
    """Return the edges ``(n, sides, 6)`` as documented: the first across the coordinate axis least along the normal."""
    if length is None:
        length, about = frame_of(grasp)
    first = np.cross(grasp.normals, np.eye(3)[np.argmin(np.abs(grasp.normals), -1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    angles = 2 * np.pi * np.arange(sides) / sides
    across = (
        np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * np.cross(grasp.normals, first)[:, None]
    )
    forces = np.asarray(grasp.normals)[:, None] + np.asarray(grasp.friction)[:, None, None] * across
    return np.concatenate([forces, np.cross(((grasp.points - about) / length)[:, None], forces)], -1)


def hull_radius(points: np.ndarray) -> float:
    """Return the radius of the hull about the origin by Qhull; joggling coplanar points moves them by 1e-9 at most."""
    hull = ConvexHull(np.concatenate([points, np.zeros((1, 6))]), qhull_options="QJ1e-10")
    return float(np.min(-hull.equations[:, -1]))


def frame_of(grasp: Grasp) -> tuple[float, np.ndarray]:
    """Return the default length and reference point of one grasp whose contacts are all present."""
    middle = np.asarray(grasp.points).mean(0)
    return float(np.sqrt(np.mean(np.sum((grasp.points - middle) ** 2, -1)))), middle


def height(grasp: Grasp, directions: np.ndarray, bound: str) -> np.ndarray:
    """Compute the body's support along scaled directions ``(f, 6)``, from the contacts' velocities."""
    length, middle = frame_of(grasp)
    linear, angular = directions[:, None, :3], directions[:, None, 3:]
    velocity = linear + np.cross(angular, (np.asarray(grasp.points) - middle) / length)
    along = np.sum(velocity * grasp.normals, -1)
    across = np.linalg.norm(velocity - along[..., None] * grasp.normals, axis=-1)
    turning = np.sum(angular * grasp.normals, -1)
    gamma = 0 if grasp.torsion is None else np.asarray(grasp.torsion) / length
    heights = along + np.sqrt((np.asarray(grasp.friction) * across) ** 2 + (gamma * turning) ** 2)
    return np.maximum(heights, 0).max(-1) if bound == "l1" else np.maximum(heights, 0).sum(-1)


def single(grasp: Grasp, index: int) -> Grasp:
    names = ("points", "normals", "friction", "squeeze", "present", "torsion")
    return Grasp(*(None if (a := getattr(grasp, name)) is None else a[index] for name in names))


def of_jax(grasp: Grasp) -> Grasp:
    names = ("points", "normals", "friction", "squeeze", "present", "torsion")
    return Grasp(*(None if (a := getattr(grasp, name)) is None else jnp.asarray(a) for name in names))
