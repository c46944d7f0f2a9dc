"""Questions about wrench sets that NumPy answers, asked from inside ``jit``, ``vmap`` and ``grad``.

What is certified is host arithmetic in float64. A program on any device calls it back with all problems of a batch at
once; it is not differentiated: each measure adds its own derivative, by the envelope theorem.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, core

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import About, Ellipsoid, Length, WrenchDiscs, measured_discs
from jaxgrasp.quality.grasp_input import ROUNDING
from jaxgrasp.quality.in_turn import TOGETHER, in_turn
from jaxgrasp.quality.wrench_sets import WrenchSets


def is_traced(*arguments: object) -> bool:
    """Return True if an array among the arguments is traced, so that its values are unknown."""
    return any(isinstance(leaf, core.Tracer) for leaf in jax.tree.leaves(arguments))


def call_on_host(
    question: Callable[..., tuple[np.ndarray, ...]],
    trailing: tuple[tuple[int, ...], ...],
    grasp: Grasp,
    length: Length,
    about: About,
    ellipsoid: Ellipsoid = None,
    *,
    extra: tuple[Array, ...] = (),
    together: int = TOGETHER,
) -> tuple[WrenchDiscs, Any]:
    """Return the discs of traced grasps and the answers of ``question`` about them, which is called on the host.

    The answers are a tuple of JAX arrays, in the places where results have arrays of NumPy.

    Args:
        question: of wrench sets ``(G, ...)``, and the rows of ``extra``, the answers: arrays ``(G, *trailing)``.
        trailing: the shape of each answer behind the grasps' axes.
        grasp: contacts ``(..., n)``.
        length: see [`jaxgrasp.quality.ferrari_canny`][].
        about: likewise.
        ellipsoid: likewise.
        extra: further arrays with the grasps' axes ``(..., k)``.
        together: grasps that are looked at side by side.
    """
    check_arguments(grasp, {}, {"length": (length, ()), "about": (about, (3,)), "ellipsoid": (ellipsoid, (6, 6))})
    shapes, growth = measured_discs(grasp, length, about, ellipsoid)
    dtype, batch = shapes.centres.dtype, shapes.length.shape
    is_present = jnp.ones(grasp.friction.shape, bool) if grasp.present is None else jnp.asarray(grasp.present) > 0.5
    reach = jnp.max(jnp.where(is_present[..., None], jnp.abs(jnp.asarray(grasp.points)), 0), (-1, -2), initial=0)
    operands = (shapes.centres, shapes.spans, is_present, growth * (1 + reach / shapes.length), *extra)
    precision = float(jnp.finfo(dtype).eps)

    def answer(centres: Array, spans: Array, present: Array, spread: Array, *extra: Array) -> tuple[np.ndarray, ...]:
        axes = np.shape(spread)
        rounding = (ROUNDING * precision * np.asarray(spread, np.float64)).reshape(-1)
        bodies = WrenchSets.of_discs(np.asarray(centres), np.asarray(spans), np.asarray(present), rounding)
        rows = [np.asarray(array, np.float64).reshape(-1, np.shape(array)[-1]) for array in extra]
        answers = in_turn(
            len(rounding),
            lambda indices: question(bodies.take(indices), *(array[indices] for array in rows)),
            together=together,
        )
        return tuple(np.asarray(array, dtype).reshape((*axes, *shape)) for array, shape in zip(answers, trailing))

    result_shapes = tuple(jax.ShapeDtypeStruct((*batch, *shape), dtype) for shape in trailing)
    return shapes, jax.pure_callback(
        answer, result_shapes, *jax.lax.stop_gradient(operands), vmap_method="broadcast_all"
    )


def with_derivative_of(value: Any, differentiable: Array) -> Any:
    """Return ``value`` with the derivative of ``differentiable``."""
    return value + (differentiable - jax.lax.stop_gradient(differentiable))
