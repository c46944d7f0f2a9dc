"""Grasps as users have them, many of which cannot hold their load: families of any size."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.random import Generator

import jaxgrasp
from jaxgrasp.cli.grasp_files import data_path
from jaxgrasp.testing.problems import problems, unit
from jaxgrasp.testing.references import Problems

LIFT = 3.0
"""Force of a lift, and weight of what is held [N]."""
BOX = (0.03, 0.04, 0.1)
"""Half lengths of a carton [m]."""
RADIUS, HEIGHT = 0.04, 0.1
"""Of a bottle [m]."""
DRAWN = 500
"""Problems inside their limits, and beyond them, that are made: the batch repeats them."""


def sampled(n: int, batch: int, lift: bool) -> Problems:
    """Return random contacts on a unit sphere, pressing inward; any wrench, or a lift by the upper half alone."""
    rng = np.random.default_rng([n, lift])
    points = unit(rng.normal(size=(batch, n, 3)))
    wrench = rng.normal(size=(batch, 6)) * np.repeat([1.0, 0.3], 3)
    if lift:
        points[..., 2] = np.abs(points[..., 2])
        wrench = np.tile([0, 0, LIFT, 0, 0, 0], (batch, 1))
    return _pressed(rng, "lift" if lift else "any", points, -points, wrench)


def carton(n: int, batch: int) -> Problems:
    """Return contacts anywhere on the six faces of a box, whose weight points anywhere."""
    rng = np.random.default_rng(n)
    sides = np.array(BOX)
    areas = np.tile(sides.prod() / sides, 2)
    face = rng.choice(6, (batch, n), p=areas / areas.sum())
    outward = np.concatenate([np.eye(3), -np.eye(3)])[face]
    points = np.where(outward == 0, rng.uniform(-sides, sides, (batch, n, 3)), outward * sides)
    wrench = np.concatenate([LIFT * unit(rng.normal(size=(batch, 3))), np.zeros((batch, 3))], -1)
    return _pressed(rng, "carton", points, -outward, wrench)


def bottle(n: int, batch: int) -> Problems:
    """Return grasps of a thumb opposite to fingers on an upright cylinder, lifted and tipped as it is poured."""
    rng = np.random.default_rng(n)
    # The fingers are spread over a third of the way round, the thumb faces their middle.
    angle = np.where(np.arange(n) == 0, np.pi, rng.uniform(-np.pi / 3, np.pi / 3, (batch, n)))
    height = rng.uniform(-HEIGHT / 2, HEIGHT / 2, (batch, n))
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    points = RADIUS * outward + height[..., None] * np.array([0, 0, 1.0])
    tip = rng.uniform(0, np.pi / 2, batch)
    force = LIFT * np.stack([np.zeros(batch), np.sin(tip), np.cos(tip)], -1)
    # What is in the bottle has run to its neck by as much as it is tipped.
    middle = np.sin(tip)[:, None] * np.array([0, 0, HEIGHT / 4])
    return _pressed(rng, "bottle", points, -outward, np.concatenate([force, np.cross(middle, force)], -1))


def limit(n: int, batch: int) -> Problems:
    """Return problems one per cent inside and beyond the largest load that the grasp can bear, half and half."""
    inside, beyond = (problems(kind, n, min(DRAWN, -(-batch // 2)), seed=5) for kind in ("limit_99", "limit_101"))
    chosen = np.random.default_rng(n).permutation(np.resize(np.arange(2 * len(inside.wrench)), batch))

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(inside, name), getattr(beyond, name)])[chosen]

    return Problems("limit", *map(joined, Problems._fields[1:6]), None)


def shipped(n: int, batch: int) -> Problems:
    """Return the package's own grips of n contacts, of hands simulated with other physics, repeated."""
    grips = jaxgrasp.load_grasps(data_path(None))
    chosen = np.resize(np.flatnonzero(np.diff(grips.offsets) == n), batch)
    contacts = grips.offsets[chosen, None] + np.arange(n)
    columns = (column[contacts] for column in (grips.points, grips.normals, grips.friction, grips.squeeze))
    return Problems("shipped", *columns, grips.wrench[chosen, 0], None)


def _pressed(rng: Generator, kind: str, points: np.ndarray, normals: np.ndarray, wrench: np.ndarray) -> Problems:
    friction, squeeze = rng.uniform(0.2, 0.6, points.shape[:2]), rng.uniform(0.5, 5, points.shape[:2])
    return Problems(kind, points, normals, friction, squeeze, wrench, None)


FAMILIES: dict[str, Callable[[int, int], Problems]] = {
    "any": partial(sampled, lift=False),
    "lift": partial(sampled, lift=True),
    "carton": carton,
    "bottle": bottle,
    "limit": limit,
    "shipped": shipped,
}
"""By name: problems of n contacts, so many."""
