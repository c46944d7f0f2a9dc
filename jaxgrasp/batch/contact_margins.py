"""Friction margins of contacts, by a single program for the contacts of all grasps, so that all batches agree.

A program for each shape of a batch would round in a way of its own.
"""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.batch.blocks import widened
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.force.slip import friction_margin, spin_force
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.compiled_code import jit_here

TILE = 1 << 14
"""Contacts that are computed at a time."""


def margins(sets: ContactSets, forces: np.ndarray, moments: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Compute the smallest friction margin of loaded contacts [rad] and the largest force beyond friction's limit [N].

    Both ``(N, W)``, for ``forces (M, W, 3)`` and, of soft fingers, ``moments (M, W)``. The margin is +inf where no
    contact is loaded; what is beyond the limit is max(|t| - mu n) or 0, moments counted as in ``friction_margin``.
    """
    shape = (len(sets), sets.wrenches)
    if not len(sets.points):
        return np.full(shape, np.inf, sets.points.dtype), np.zeros(shape, sets.points.dtype)
    margin, beyond = np.empty(forces.shape[:2], forces.dtype), np.empty(forces.shape[:2], forces.dtype)
    for wrench in range(sets.wrenches):
        for first in range(0, len(sets.points), TILE):
            tile = slice(first, first + TILE)
            torsion = None if sets.torsion is None else sets.torsion[tile]
            moment = None if moments is None else moments[tile, wrench]
            arrays = (sets.normals[tile], sets.friction[tile], torsion, forces[tile, wrench], moment)
            count = len(arrays[1])
            results = _program()(jax.tree.map(partial(widened, missing=TILE - count), arrays))
            margin[tile, wrench], beyond[tile, wrench] = (np.asarray(values)[:count] for values in results)
    starts = sets.offsets[:-1]
    return np.minimum.reduceat(margin, starts), np.maximum(np.maximum.reduceat(beyond, starts), 0)


@cache
def _program() -> Any:
    return jit_here(_contact_margins)


def _contact_margins(contact_arrays: tuple[Array | None, ...]) -> tuple[Array, Array]:
    """Compute the margin and the tangential force beyond friction's limit of each contact, as a grasp of its own."""
    normals, friction, torsion, forces, moments = jax.tree.map(
        lambda array: jnp.asarray(array)[:, None], contact_arrays
    )
    grasp = Grasp(jnp.zeros_like(normals), normals, friction, jnp.zeros_like(friction), torsion=torsion)
    force, normal = vec3.from_axis(forces, -1), vec3.from_axis(normals, -1)
    across, spin = vec3.norm(vec3.cross(normal, force)), spin_force(grasp, moments)
    if spin is not None:
        across = jnp.hypot(across, spin)
    # |t| - mu n: above zero outside of the cone.
    beyond = across - friction * vec3.dot(force, normal)
    return friction_margin(grasp, forces, moments)[:, 0], beyond[:, 0]
