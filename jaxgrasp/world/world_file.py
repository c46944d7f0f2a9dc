"""The world of a scene file: the gripped object and all others, at their initial poses."""

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
from jaxgrasp.world.many_bodies import RigidBody, World, WorldState, at_rest
from jaxgrasp.world.solids import manifold_between, solid_of, table_manifold


class _PlacedShape(NamedTuple):
    """A shape at a pose, with its name in the file."""

    name: str
    shape: Shape
    placed: Pose


@checked
def world_of(file: SceneFile, gripped_scene: GrippedScene) -> tuple[World, WorldState]:
    """Build the world of a scene file, at rest.

    Args:
        file: scene file with the further objects.
        gripped_scene: scene with its hand closed on the gripped object.

    Raises:
        ValueError: for a mesh that is not a closed surface, and an object that begins inside another, the table or an
            obstacle; the message has the depth.
        ImportError: for a mesh without the extra `mesh`.
    """
    _check_single_object_fields(file)
    origin = np.asarray(gripped_scene.placed.origin, float)
    other_solids = [
        _PlacedShape(f"other[{k}]", entry.solid(), Pose(origin + entry.at, np.asarray(entry.rotation(), float)))
        for k, entry in enumerate(file.other)
    ]
    gripped_solid = _PlacedShape(
        "the object", gripped_scene.scene.body.shape, Pose(origin, np.asarray(gripped_scene.placed.rotation, float))
    )
    obstacles = [
        _PlacedShape(f"obstacle[{k}]", o.shape, o.placed)
        for k, o in enumerate(at_time(gripped_scene.scene, 0.0).obstacles)
    ]
    for k, entry_solid in enumerate(other_solids):
        depth = -table_manifold(solid_of(entry_solid.shape, entry_solid.placed), gripped_scene.scene.table).gap
        _check_depth(entry_solid.name, depth, "the table")
        for neighbour in chain([gripped_solid], other_solids[:k], obstacles):
            _check_depth(entry_solid.name, _depth(entry_solid, neighbour), neighbour.name)
    rigid_bodies = [
        RigidBody(
            Body(entry_solid.shape, entry.mass), entry.friction, entry.stiffness, entry.rubbing, entry.torsion or None
        )
        for entry_solid, entry in zip(other_solids, file.other, strict=True)
    ]
    solids = [gripped_solid, *other_solids]
    placed = Pose(*(np.stack([getattr(solid.placed, part) for solid in solids]) for part in ("origin", "rotation")))
    return World(gripped_scene.scene, tuple(rigid_bodies)), at_rest(placed)


def _check_single_object_fields(file: SceneFile) -> None:
    """Raise ValueError for fields that apply to a single object only."""
    entries = {"object": file.object} | {f"other[{k}]": entry for k, entry in enumerate(file.other)}
    for name, entry in entries.items():
        for key in ("centre_of_mass", "inertia"):
            if (value := getattr(entry, key)) is not None:
                raise ValueError(f"{name}.{key} is {list(value)}: expected a uniform density among several objects")
    for k, obstacle in enumerate(file.obstacle):
        for key in ("friction", "damping"):
            if value := getattr(obstacle, key):
                raise ValueError(f"obstacle[{k}].{key} is {value}: expected 0 among several objects")


def _check_depth(name: str, depth: float, neighbour: str) -> None:
    if depth > APART:
        raise ValueError(f"{name} begins {1000 * depth:.3g} mm deep in {neighbour}: expected it outside")


def _depth(first: _PlacedShape, second: _PlacedShape) -> float:
    """Compute the depth of penetration of two solids [m], negative for separated ones; for trees by their balls."""
    if not isinstance(first.shape, SphereTree):
        if isinstance(second.shape, SphereTree):
            return _depth(second, first)
        manifold = manifold_between(solid_of(first.shape, first.placed), solid_of(second.shape, second.placed), 0.0)
        return -np.inf if manifold is None else -manifold.gap
    centers, radii = _balls(first.shape, first.placed)
    if isinstance(second.shape, SphereTree):
        other_centers, sizes = _balls(second.shape, second.placed)
        distances = np.array([np.min(np.linalg.norm(center - other_centers, axis=1) - sizes) for center in centers])
    else:
        local_centers = (centers - np.asarray(second.placed.origin)) @ np.asarray(second.placed.rotation)
        distances = np.asarray(signed_distance(second.shape, jnp.asarray(local_centers))[0])
    return float(np.max(radii - distances))


def _balls(tree: SphereTree, placed: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of a tree's balls in the world, and their radii."""
    centers = np.asarray(tree.balls.centers) @ np.asarray(placed.rotation).T + np.asarray(placed.origin)
    return centers, np.asarray(tree.balls.radii)
