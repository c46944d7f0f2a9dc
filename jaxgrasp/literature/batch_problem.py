"""A batch of problems brought to order one, as the methods that run in JAX solve it, and the way back."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.method_answer import MethodAnswer
from jaxgrasp.literature.method_input import MethodInput


class ScaledBatch(NamedTuple):
    """B problems: lengths in radii about the centroid of the contacts that are present, forces in units of the load.

    Absent contacts stay in their place: ``present`` is 0 there, and so are arms, normals and friction.
    """

    arms: Array
    normals: Array
    friction: Array
    present: Array
    wrench: Array


class BatchResult(NamedTuple):
    """What a method finds, forces in units of the load."""

    forces: Array
    status: Array
    objective: Array
    iterations: Array


def solve_all(given: MethodInput, solve: Callable[[ScaledBatch, Array], BatchResult], unit: int) -> MethodAnswer:
    """All problems in one call, in double precision whatever JAX's mode.

    Args:
        given: the problems.
        solve: takes them scaled, and their loads [N] ``(B,)``.
        unit: power of the load by which the objective scales.
    """
    count, n = given.friction.shape
    if count == 0:
        return given.answer(np.zeros((0, n, 3)), np.zeros(0), np.zeros(0), np.zeros(0, int))
    with jax.enable_x64(True):
        problem, load = scale(given)
        found = jax.device_get(solve(problem, jnp.asarray(load)))
    forces = load[:, None, None] * found.forces
    return given.answer(forces, found.status, load**unit * found.objective, found.iterations)


def scale(given: MethodInput) -> tuple[ScaledBatch, np.ndarray]:
    """The problems scaled, as arrays of JAX's current precision, and their loads [N].

    A load is the sum of squeezing forces, force, and torque over the radius.
    """
    present = given.present.astype(float)
    count = np.maximum(present.sum(-1), 1)
    centre = given.points.sum(1) / count[:, None]
    arms = (given.points - centre[:, None]) * present[..., None]
    length = np.sqrt(np.sum(arms**2, (1, 2)) / count)
    away = np.linalg.norm(centre, axis=-1)
    # Contacts in one point, but for rounding of the mean, have no length of their own.
    length = np.where(length > 16 * np.finfo(float).eps * away, length, np.where(away > 0, away, 1.0))
    force = given.wrench[:, :3]
    torque = (given.wrench[:, 3:] - np.cross(centre, force)) / length[:, None]
    load = given.squeeze.sum(-1) + np.linalg.norm(force, axis=-1) + np.linalg.norm(torque, axis=-1)
    load = np.where(load > 0, load, 1.0)
    size = np.linalg.norm(given.normals, axis=-1, keepdims=True)
    normals = given.normals / np.where(size > 0, size, 1.0)
    wrench = np.concatenate([force, torque], -1) / load[:, None]
    arrays = (arms / length[:, None, None], normals, given.friction, present, wrench)
    return ScaledBatch(*map(jnp.asarray, arrays)), load
