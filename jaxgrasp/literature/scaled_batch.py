"""A batch of problems brought to order one, as all methods of the literature solve it."""

from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.literature.method_input import MethodInput
from jaxgrasp.numerics.centring import centred


class ScaledBatch(NamedTuple):
    """B problems: lengths in radii about the centroid of the contacts that are present, forces in units of the load.

    Absent contacts stay in their place: ``present`` is 0 there, and so are arms, normals and friction. The arrays are
    NumPy's, or JAX's for methods that run there.
    """

    arms: Any
    """Points about the centroid ``(B, n, 3)`` [radius]."""
    normals: Any
    friction: Any
    present: Any
    wrench: Any


def scale(given: MethodInput) -> tuple[ScaledBatch, np.ndarray]:
    """The problems scaled, and their loads ``(B,)`` [N]: squeezing forces, force, and torque over the radius."""
    centre, arms, radius = centred(given.points, given.present, numpy=np)
    away = np.linalg.norm(centre, axis=-1)
    # Contacts in one point have no length of their own.
    length = np.where(radius > 0, radius, np.where(away > 0, away, 1.0))
    force = given.wrench[:, :3]
    torque = (given.wrench[:, 3:] - np.cross(centre, force)) / length[:, None]
    load = given.squeeze.sum(-1) + np.linalg.norm(force, axis=-1) + np.linalg.norm(torque, axis=-1)
    load = np.where(load > 0, load, 1.0)
    size = np.linalg.norm(given.normals, axis=-1, keepdims=True)
    normals = given.normals / np.where(size > 0, size, 1.0)
    wrench = np.concatenate([force, torque], -1) / load[:, None]
    return ScaledBatch(arms / length[:, None, None], normals, given.friction, given.present.astype(float), wrench), load
