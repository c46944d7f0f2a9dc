"""Seeded problems of 32 kinds, eight ways to place contacts by four to load them; NumPy alone.

Nothing here comes from the solver, or from the problems of ``jaxgrasp.testing``: what the two have in common, both
would overlook.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import Generator


class Sample(NamedTuple):
    """Problems of one kind: points and normals ``(B, n, 3)``, friction and squeeze ``(B, n)``, wrench ``(B, 6)``."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    wrench: np.ndarray


class Placed(NamedTuple):
    """Contacts without a load, and the size of the object [m]."""

    points: np.ndarray
    normals: np.ndarray
    size: float


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(np.sum(vectors**2, -1, keepdims=True))


def _directions(rng: Generator, *shape: int) -> np.ndarray:
    return _unit(rng.normal(size=(*shape, 3)))


def _on_a_sphere(rng: Generator, count: int, n: int) -> Placed:
    out = _directions(rng, count, n)
    return Placed(0.04 * out, -out, 0.04)


def _on_a_box(rng: Generator, count: int, n: int) -> Placed:
    """Place contacts on random faces of a box."""
    axis, side = rng.integers(3, size=(count, n)), rng.choice([-1.0, 1.0], size=(count, n))
    normals = -side[..., None] * np.eye(3)[axis]
    points = rng.uniform(-0.05, 0.05, (count, n, 3))
    points = np.where(normals != 0, -0.05 * normals, points)
    return Placed(points, normals, 0.05)


def _on_a_bottle(rng: Generator, count: int, n: int) -> Placed:
    """Round a cylinder, with normals that lean a little, as those of measured surfaces do."""
    turn = rng.uniform(0, 2 * np.pi, (count, n))
    out = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], -1)
    height = np.array([0, 0, 1.0]) * rng.uniform(-0.1, 0.1, (count, n, 1))
    return Placed(0.03 * out + height, _unit(-out + 0.1 * rng.normal(size=out.shape)), 0.05)


def _along_an_edge(rng: Generator, count: int, n: int) -> Placed:
    """Place contacts off a line by anything between a tenth and a millionth of its length."""
    line, off = _directions(rng, count, 1), 10 ** rng.uniform(-6, -1, (count, 1, 1))
    points = 0.05 * (rng.uniform(-1, 1, (count, n, 1)) * line + off * rng.normal(size=(count, n, 3)))
    return Placed(points, _directions(rng, count, n), 0.05)


def _on_a_plate(rng: Generator, count: int, n: int) -> Placed:
    """Place contacts on two sides, all points in nearly one plane."""
    points = 0.06 * rng.normal(size=(count, n, 3)) * (1, 1, 1e-3)
    normals = np.array([0, 0, 1.0]) * rng.choice([-1.0, 1.0], size=(count, n, 1))
    return Placed(points, _unit(normals + 0.05 * rng.normal(size=points.shape)), 0.06)


def _from_one_side(rng: Generator, count: int, n: int) -> Placed:
    """Place contacts as a hand that only pushes does: most loads have no allowed forces."""
    out = _directions(rng, count, n) + (0, 0, 1.5)
    points = 0.04 * _unit(out)
    return Placed(points, _unit(-out), 0.04)


def _far_away(rng: Generator, count: int, n: int) -> Placed:
    out = _directions(rng, count, n)
    return Placed(0.04 * out + 3 * _directions(rng, count, 1), -out, 0.04)


def _crowded(rng: Generator, count: int, n: int) -> Placed:
    """Crowd the contacts at two points, with normals of their own."""
    where = 0.04 * _directions(rng, count, 2)
    is_odd = (np.arange(n) % 2)[None, :, None]
    points = np.where(is_odd, where[:, 1:], where[:, :1])
    return Placed(points, _unit(-points + 0.01 * rng.normal(size=points.shape)), 0.04)


PLACES: dict[str, Callable[[Generator, int, int], Placed]] = {
    "sphere": _on_a_sphere,
    "box": _on_a_box,
    "bottle": _on_a_bottle,
    "edge": _along_an_edge,
    "plate": _on_a_plate,
    "one_side": _from_one_side,
    "far_away": _far_away,
    "crowded": _crowded,
}


def _about_the_middle(placed: Placed, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return np.concatenate([force, torque + np.cross(placed.points.mean(1), force)], -1)


def _any(rng: Generator, placed: Placed, friction: np.ndarray, squeeze: np.ndarray) -> np.ndarray:
    force, torque = rng.normal(size=(2, len(friction), 3))
    return _about_the_middle(placed, force, placed.size * torque)


def _lift(rng: Generator, placed: Placed, friction: np.ndarray, squeeze: np.ndarray) -> np.ndarray:
    weight = np.array([0, 0, 1.0]) * rng.uniform(0.1, 10, (len(friction), 1))
    return _about_the_middle(placed, weight, 0.1 * placed.size * rng.normal(size=weight.shape))


def _light(rng: Generator, placed: Placed, friction: np.ndarray, squeeze: np.ndarray) -> np.ndarray:
    return _any(rng, placed, friction, squeeze) * 10 ** rng.uniform(-14, -2, (len(friction), 1))


def _held(rng: Generator, placed: Placed, friction: np.ndarray, squeeze: np.ndarray) -> np.ndarray:
    """Return wrenches of random allowed forces, some of which use up their friction."""
    along = squeeze * np.exp(rng.normal(size=squeeze.shape))
    across = np.cross(placed.normals, _directions(rng, *friction.shape))
    used = np.minimum(rng.uniform(0, 1.5, friction.shape), 1) * friction
    forces = (along[..., None] * (placed.normals + used[..., None] * _unit(across))).astype(np.longdouble)
    torque = np.cross(placed.points.astype(np.longdouble), forces)
    return np.concatenate([forces.sum(1), torque.sum(1)], -1).astype(float)


LOADS: dict[str, Callable[[Generator, Placed, np.ndarray, np.ndarray], np.ndarray]] = {
    "any": _any,
    "lift": _lift,
    "light": _light,
    "held": _held,
}
KINDS = tuple(f"{place}-{load}" for place in PLACES for load in LOADS)


def sample(kind: str, n: int, count: int, seed: int) -> Sample:
    """Draw ``count`` problems; the same arguments give the same ones.

    A tenth of the contacts has no friction, a tenth a thousandth of it, a tenth squeezes a thousandth.
    """
    place, load = kind.split("-")
    rng = np.random.default_rng([seed, n, KINDS.index(kind)])
    placed = PLACES[place](rng, count, n)
    friction, squeeze = rng.uniform(0.1, 1.0, (count, n)), 10 ** rng.uniform(-1, 1, (count, n))
    odd = rng.uniform(size=(count, n))
    friction = friction * np.select([odd < 0.1, odd < 0.2], [0.0, 1e-3], 1.0)
    squeeze = squeeze * np.where(odd > 0.9, 1e-3, 1.0)
    return Sample(placed.points, placed.normals, friction, squeeze, LOADS[load](rng, placed, friction, squeeze))
