"""The world of a scene file: the gripped object and all others, where they stand at first."""

from itertools import chain
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import at_time
from jaxgrasp.grip.scene_file import APART, GrippedScene, SceneFile
from jaxgrasp.hand.shapes import Shape, signed_distance
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.hand import Pose
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.many_bodies import Thing, World, WorldState, at_rest
from jaxgrasp.world.solids import solid_of
from jaxgrasp.world.touching_solids import patch_between, table_patch


class _Named(NamedTuple):
    """A solid that stands somewhere, and what the file calls it."""

    name: str
    shape: Shape
    placed: Pose


@checked
def world_of(file: SceneFile, made: GrippedScene) -> tuple[World, WorldState]:
    """The world of a scene file, at rest.

    Args:
        file: whose further objects count.
        made: its hand closed on the gripped object.

    Raises:
        ValueError: for a mesh that is no closed surface, and an object that begins inside another, the table or an
            obstacle: it says how deep.
        ImportError: for a mesh without the extra `mesh`.
    """
    _check_plain(file)
    origin = np.asarray(made.placed.origin, float)
    others = [
        _Named(f"other[{k}]", entry.solid(), Pose(origin + entry.at, np.asarray(entry.rotation(), float)))
        for k, entry in enumerate(file.other)
    ]
    gripped = _Named("the object", made.scene.body.shape, Pose(origin, np.asarray(made.placed.rotation, float)))
    obstacles = [_Named(f"obstacle[{k}]", o.shape, o.placed) for k, o in enumerate(at_time(made.scene, 0.0).obstacles)]
    for k, one in enumerate(others):
        deep = -table_patch(solid_of(one.shape, one.placed), made.scene.table).gap
        _refuse(one.name, deep, "the table")
        for other in chain([gripped], others[:k], obstacles):
            _refuse(one.name, _depth(one, other), other.name)
    things = [
        Thing(Body(one.shape, entry.mass), entry.friction, entry.stiffness, entry.rubbing, entry.torsion or None)
        for one, entry in zip(others, file.other, strict=True)
    ]
    everything = [gripped, *others]
    placed = Pose(*(np.stack([getattr(one.placed, part) for one in everything]) for part in ("origin", "rotation")))
    return World(made.scene, tuple(things)), at_rest(placed)


def _check_plain(file: SceneFile) -> None:
    """Raise ValueError for what moves one object alone."""
    named = {"object": file.object} | {f"other[{k}]": entry for k, entry in enumerate(file.other)}
    for name, entry in named.items():
        for key in ("centre_of_mass", "inertia"):
            if (given := getattr(entry, key)) is not None:
                raise ValueError(f"{name}.{key} is {list(given)}: expected a uniform density among several objects")
    for k, obstacle in enumerate(file.obstacle):
        for key in ("friction", "damping"):
            if given := getattr(obstacle, key):
                raise ValueError(f"obstacle[{k}].{key} is {given}: expected none among several objects")


def _refuse(name: str, depth: float, other: str) -> None:
    if depth > APART:
        raise ValueError(f"{name} begins {1000 * depth:.3g} mm deep in {other}: expected it outside")


def _depth(one: _Named, other: _Named) -> float:
    """How deep solids are in one another [m], below zero for those that are apart; of trees by their balls."""
    if not isinstance(one.shape, SphereTree):
        if isinstance(other.shape, SphereTree):
            return _depth(other, one)
        patch = patch_between(solid_of(one.shape, one.placed), solid_of(other.shape, other.placed), 0.0)
        return -np.inf if patch is None else -patch.gap
    centers, radii = _balls(one.shape, one.placed)
    if isinstance(other.shape, SphereTree):
        its, sizes = _balls(other.shape, other.placed)
        apart = np.array([np.min(np.linalg.norm(center - its, axis=1) - sizes) for center in centers])
    else:
        own = (centers - np.asarray(other.placed.origin)) @ np.asarray(other.placed.rotation)
        apart = np.asarray(signed_distance(other.shape, jnp.asarray(own))[0])
    return float(np.max(radii - apart))


def _balls(tree: SphereTree, placed: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Centres in the world, and radii."""
    centers = np.asarray(tree.balls.centers) @ np.asarray(placed.rotation).T + np.asarray(placed.origin)
    return centers, np.asarray(tree.balls.radii)
