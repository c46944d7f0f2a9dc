"""How a question is asked of a batch: any leading axes, and few programs for many sizes.

Inside another program, or where derivatives are taken, a question is part of what is traced. Asked alone it is padded
to one of few sizes, by NumPy, and compiled once for each of these; the tiles stop at the true count, so that padding
costs memory alone.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.flat import Flat, Sharing, flatten, read_sharing
from jaxgrasp.force.lanes import Problem
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.numerics.compiled_code import compile_options

SIZES = (1, 10, 100, *(base * 10**power for power in range(3, 9) for base in (1, 3)))
"""Batches are padded to the next of these: round numbers, since users like them, and few where memory is no matter."""

Solve = Callable[..., Any]
"""From a flat batch of problems, and one array for each of them by name, to a tree of arrays ``(B, ...)``."""


class Given(NamedTuple):
    """What a user gives beside the sharing."""

    grasp: Grasp
    wrench: AnyArray
    weights: AnyArray | None
    free: AnyArray | None
    limits: Limits | None
    safety: float | AnyArray | None
    each: Mapping[str, AnyArray | float]


def ask(
    solve: Solve,
    grasp: Grasp,
    wrench: AnyArray,
    sharing: Sharing,
    *,
    free: AnyArray | None = None,
    limits: Limits | None = None,
    safety: float | AnyArray | None = None,
    tails: tuple[tuple[str, tuple[int, ...]], ...] = (),
    **each: AnyArray | float | None,
) -> Any:
    """The answers of ``solve`` with the leading axes of what was given.

    ``each`` are further arrays, one for each problem, whose last axes ``tails`` name, or ``(6,)``; those that are None
    are left out.
    """
    name, weights = read_sharing(sharing)
    there = {key: array for key, array in each.items() if array is not None}
    given = Given(grasp, wrench, weights, free, limits, safety, there)
    if not _is_alone(given):
        return _within(given, solve=solve, sharing=name, tails=tails)
    try:
        if _size(given, tails) in SIZES:
            return _exactly()(given, solve=solve, sharing=name, tails=tails)
        return _padded(solve, given, name, tails)
    except ValueError as error:
        if "compiler_options" not in str(error):
            raise
        # Constants inside another program, which has its own options.
        return _within(given, solve=solve, sharing=name, tails=tails)


def _flat(given: Given, sharing: str, tails: tuple, numpy: Any) -> Flat:
    last = dict(tails)
    each = {name: (array, last.get(name, (6,))) for name, array in given.each.items()}
    return flatten(
        given.grasp,
        given.wrench,
        given.weights,
        sharing,
        free=given.free,
        limits=given.limits,
        safety=given.safety,
        each=each,
        numpy=numpy,
    )


def _traced(given: Given, *, solve: Solve, sharing: str, tails: tuple) -> Any:
    flat = _flat(given, sharing, tails, jnp)
    return jax.tree.map(lambda x: x.reshape(flat.batch + x.shape[1:]), solve(Problem(**flat.fields), **flat.each))


STATIC = ("solve", "sharing", "tails")
_within = jax.jit(_traced, static_argnames=STATIC)


@cache
def _exactly() -> Callable[..., Any]:
    """The same alone: the least work before and after, for sizes that need no padding."""
    return jax.jit(_traced, static_argnames=STATIC, compiler_options=compile_options())


def _is_alone(given: Given) -> bool:
    """Whether all is data on this machine's one processor: neither traced, nor spread, nor on another device."""
    if jax.default_backend() != "cpu":
        return False
    here = {jax.devices()[0]}
    for leaf in jax.tree.leaves(given):
        if isinstance(leaf, jax.core.Tracer) or (isinstance(leaf, Array) and leaf.devices() != here):
            return False
    return True


def _size(given: Given, tails: tuple) -> int | None:
    """How many problems there are, as far as grasp, wrench and ``each`` tell; None where that makes no sense."""
    grasp, last = given.grasp, dict(tails)
    shapes = [np.shape(grasp.points)[:-2], np.shape(grasp.friction)[:-1], np.shape(given.wrench)[:-1]]
    for name, array in given.each.items():
        shape = np.shape(array)
        shapes.append(shape[: len(shape) - len(last.get(name, (6,)))])
    try:
        return math.prod(np.broadcast_shapes(*shapes))
    except ValueError:
        return None  # whoever reads the arrays says what is wrong


def _padded(solve: Solve, given: Given, sharing: str, tails: tuple) -> Any:
    flat = _flat(given, sharing, tails, np)
    size = len(flat.fields["wrench"])
    room = SIZES[bisect_left(SIZES, size)] if 0 < size <= SIZES[-1] else size

    def pad(array: np.ndarray) -> np.ndarray:
        if len(array) != size:
            return array  # shared by all
        return np.concatenate([array, np.zeros((room - size, *array.shape[1:]), array.dtype)])

    found = _padded_program(solve)(*jax.tree.map(pad, (flat.fields, flat.each)), np.int32(size))
    leaves, structure = jax.tree.flatten(found)
    # By NumPy, since each new shape would be a program of its own.
    cut = [np.asarray(leaf)[:size].reshape(flat.batch + leaf.shape[1:]) for leaf in leaves]
    return jax.tree.unflatten(structure, jax.device_put(cut))


@cache
def _padded_program(solve: Solve) -> Callable:
    def run(fields: dict[str, Array], each: dict[str, Array], count: Array) -> Any:
        return solve(Problem(**fields, count=count), **each)

    return jax.jit(run, compiler_options=compile_options())
