"""Singular values of the grasp matrix: the evenness with which forces at the contacts make up wrenches."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.wrench import grasp_matrix
from jaxgrasp.numerics.no_derivative import refusing
from jaxgrasp.numerics.vec3 import safe_divide
from jaxgrasp.problem.wrench_discs import About, Length, discs
from jaxgrasp.validation.checked import checked


@checked
def singular_values(grasp: Grasp, *, length: Length = None, about: About = None) -> Float[Array, "... 6"]:
    """Compute the six singular values of the scaled grasp matrix, largest first.

    The matrix is that of eq. 1 for the present contacts, about ``about`` and with its torque rows divided by
    ``length``: it maps forces of any direction, so neither friction nor normals count, nor do moments of soft
    fingers. The least value is the smallest wrench that forces of length 1 (all together, the root of the sum of
    their squares) exert at worst. A larger length makes all of them smaller or leaves them.

    Differentiable once, also where values are zero; where several are equal, the derivative of each is that of one
    choice among them, and that of their sum or product is exact.

    Source: Roa and Suarez, Grasp quality measures: review and performance, Autonomous Robots 38, 2015.

    Args:
        grasp: contacts ``(..., n)``.
        length: what torques are divided by, ``(...)`` [m]; see [`jaxgrasp.quality.ferrari_canny`][].
        about: where torques are taken, ``(..., 3)`` [m]; likewise.

    Returns:
        ``(..., 6)``; zeros, within rounding, for directions that no force reaches.

    Raises:
        NotImplementedError: when differentiated twice.
    """
    check_arguments(grasp, {}, {"length": (length, ()), "about": (about, (3,))})
    return _run(grasp, length, about)


@checked
def least_singular_value(grasp: Grasp, *, length: Length = None, about: About = None) -> Float[Array, "..."]:
    """Compute the last of [`jaxgrasp.quality.singular_values`][]: 0 where some wrench is out of reach of any forces."""
    check_arguments(grasp, {}, {"length": (length, ()), "about": (about, (3,))})
    return _run(grasp, length, about)[..., -1]


@checked
def grasp_volume(grasp: Grasp, *, length: Length = None, about: About = None) -> Float[Array, "..."]:
    """Multiply all [`jaxgrasp.quality.singular_values`][], sqrt(det G G^T): the volume of wrenches of unit forces."""
    check_arguments(grasp, {}, {"length": (length, ()), "about": (about, (3,))})
    return jnp.prod(_run(grasp, length, about), -1)


@checked
def grasp_isotropy(grasp: Grasp, *, length: Length = None, about: About = None) -> Float[Array, "..."]:
    """Divide the least of [`jaxgrasp.quality.singular_values`][] by the largest: 1 if all wrenches are equally easy."""
    check_arguments(grasp, {}, {"length": (length, ()), "about": (about, (3,))})
    values = _run(grasp, length, about)
    return safe_divide(values[..., -1], values[..., 0])


@jax.jit
def _run(grasp: Grasp, length: Length, about: About) -> Array:
    return _values(_scaled_matrix(grasp, length, about))


def _scaled_matrix(grasp: Grasp, length: Length, about: About) -> Array:
    """Compute the scaled grasp matrix ``(..., 6, 3n)``, padded with zero columns to at least six."""
    frame = discs(grasp, length, about)
    present = jnp.ones(grasp.friction.shape, bool) if grasp.present is None else jnp.asarray(grasp.present) > 0.5
    points = jnp.where(present[..., None], grasp.points, frame.about[..., None, :])
    matrix = grasp_matrix((points - frame.about[..., None, :]) / frame.length[..., None, None])
    matrix = jnp.where(jnp.repeat(present, 3, -1)[..., None, :], matrix, 0)
    missing = max(0, 6 - matrix.shape[-1])
    return jnp.pad(matrix, [(0, 0)] * (matrix.ndim - 1) + [(0, missing)])


@jax.custom_jvp
def _values(matrix: Array) -> Array:
    return _decomposed(matrix)[1]


@_values.defjvp
def _values_move(primals, tangents):
    left, values, right = _decomposed(*primals)
    return values, jnp.einsum("...ik,...ij,...kj->...k", left, tangents[0], right)


@jax.custom_jvp
def _decomposed(matrix: Array) -> tuple[Array, Array, Array]:
    left, values, right = jnp.linalg.svd(matrix, full_matrices=False)
    return left, values, right


_decomposed.defjvp(refusing("singular values have first derivatives only"))
