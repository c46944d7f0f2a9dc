"""The public answers: which force at each contact, by closed form or by constrained optimum."""

import warnings
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force import outside, shells
from jaxgrasp.force.lanes import Problem
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution

Sharing = str | AnyArray


def closed_form(grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze") -> Solution:
    """Forces closest to the squeezing forces that balance a wrench, friction not imposed.

    Minimises the sum of |f_i - s_i a_i|^2 / (2 k_i) subject to G f = w.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: the weights k: ``"uniform"`` for 1, method A (eq. 11); ``"squeeze"`` for s, method B
            (eq. 15, Proposition 1); or an array ``(..., n)`` of weights, zero or more. A contact of
            weight zero keeps its squeezing force.

    Returns:
        A Solution whose verdict says whether these forces lie inside the friction cones too.

    Raises:
        ValueError: for a sharing that is not one of these, or shapes that do not fit.
    """
    return _distribute(grasp, wrench, sharing, constrained=False)


def constrained_optimum(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    safety: float | Array = 1.0,
    solver: Any = None,
) -> Solution:
    """The closed form's problem with Coulomb's cones imposed (eqs. 1 to 3 with eq. 5 or 13), solved exactly.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].
        safety: friction is divided by this, since an optimum on a cone's surface has no margin left.
        solver: ``None`` for this package's own Newton method; or an optimistix root finder, least-squares
            solver or minimiser, which then climbs the dual in at most 256 steps, such as
            ``optimistix.Newton(rtol=1e-8, atol=1e-8)``. What it finds is OPTIMAL only where it stands our
            own tests of residual, duality gap and balance, at the larger of its rtol and atol; else
            NOT_CONVERGED. Derivatives are the same.

    Returns:
        A Solution. Where the closed form lies inside all cones it is the answer, at its own price; where
        no forces exist the verdict is INFEASIBLE and the certificate proves it.

    Raises:
        ValueError: for a sharing or a safety that cannot be used, or shapes that do not fit.
        TypeError: for a solver that is none of these, or whose settings are arrays.
    """
    if solver is not None:
        outside.check_solver(solver)
    if not isinstance(safety, jax.core.Tracer) and not np.all(np.asarray(safety) > 0):
        raise ValueError(f"safety is {safety}: expected a number greater than 0")
    friction = jnp.asarray(grasp.friction) / jnp.asarray(safety, jnp.asarray(grasp.friction).dtype)
    safe = Grasp(grasp.points, grasp.normals, friction, grasp.squeeze, grasp.present)
    return _distribute(safe, wrench, sharing, constrained=True, solver=solver)


class ForceSplit(NamedTuple):
    """The two terms of eq. 16; their sum is the closed form."""

    external: Array
    """Manipulation forces ``(..., n, 3)`` [N]: they balance the wrench."""
    internal: Array
    """Squeezing forces less their own resultant ``(..., n, 3)`` [N]: they balance to zero."""


def split_forces(grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze") -> ForceSplit:
    """The closed form as external (manipulation) and internal (grasping) forces, eq. 16."""
    squeeze = jnp.asarray(grasp.squeeze)
    if isinstance(sharing, str):
        _check_sharing(sharing)
        sharing = squeeze if sharing == "squeeze" else jnp.ones_like(squeeze)
    relaxed = Grasp(grasp.points, grasp.normals, grasp.friction, jnp.zeros_like(squeeze), grasp.present)
    wrench = jnp.asarray(wrench)
    return ForceSplit(
        external=closed_form(relaxed, wrench, sharing).forces,
        internal=closed_form(grasp, jnp.zeros_like(wrench), sharing).forces,
    )


def _distribute(grasp: Grasp, wrench: AnyArray, sharing: Sharing, *, constrained: bool, solver: Any = None) -> Solution:
    warn_of_lost_precision(grasp, wrench)
    name, weights = read_sharing(sharing)
    return _run(grasp, wrench, weights, sharing=name, constrained=constrained, solver=solver)


@partial(jax.jit, static_argnames=("sharing", "constrained", "solver"))
def _run(grasp, wrench, weights, *, sharing: str, constrained: bool, solver: Any) -> Solution:
    """Flatten the leading axes, solve, and restore them."""
    problem, _, batch = flatten(grasp, wrench, weights, sharing)
    solution = shells.solver(constrained, solver)(problem)
    return jax.tree.map(lambda x: x.reshape(batch + x.shape[1:]), solution)


def read_sharing(sharing: Sharing) -> tuple[str, AnyArray | None]:
    """The name of a sharing, and the weights of one that is given as such."""
    if not isinstance(sharing, str):
        return "given", sharing
    _check_sharing(sharing)
    return sharing, None


def _check_sharing(sharing: str) -> None:
    if sharing not in ("squeeze", "uniform"):
        raise ValueError(f"sharing is {sharing!r}: expected 'squeeze', 'uniform' or an array of weights")


class Flat(NamedTuple):
    """Problems with their leading axes broadcast and flattened into one."""

    problem: Problem
    multiplier: Array | None
    """``(B, 6)`` where one was given."""
    batch: tuple[int, ...]
    """The leading axes."""


def flatten(
    grasp: Grasp, wrench: AnyArray, weights: AnyArray | None, sharing: str, multiplier: AnyArray | None = None
) -> Flat:
    """Inputs of any leading axes as a flat batch in one precision."""
    points, normals, friction, squeeze = grasp.points, grasp.normals, grasp.friction, grasp.squeeze
    n = _contacts(points)
    if sharing != "given":
        weights = squeeze if sharing == "squeeze" else jnp.ones(np.shape(points)[:-1])
    given = {
        "points": (points, (n, 3)),
        "normals": (normals, (n, 3)),
        "friction": (friction, (n,)),
        "squeeze": (squeeze, (n,)),
        "present": (grasp.present, (n,)),
        "weights": (weights, (n,)),
        "wrench": (wrench, (6,)),
        "multiplier": (multiplier, (6,)),
    }
    precise = (points, normals, friction, squeeze, wrench, multiplier)
    dtype = _precision(*(array for array in precise if array is not None))
    arrays = {name: jnp.asarray(array, dtype) for name, (array, _) in given.items() if array is not None}
    leading = {name: _leading_axes(name, array, given[name][1]) for name, array in arrays.items()}
    batch = jnp.broadcast_shapes(*leading.values())
    # A grasp that all wrenches share stays one grasp: its own work is then done once.
    loads = ("wrench", "multiplier")
    shared = all(int(np.prod(axes)) == 1 for name, axes in leading.items() if name not in loads)
    flat = {}
    for name, array in arrays.items():
        tail = given[name][1]
        if shared and name not in loads:
            flat[name] = array.reshape(1, *tail)
        else:
            flat[name] = jnp.broadcast_to(array, batch + tail).reshape(-1, *tail)
    multiplier = flat.pop("multiplier", None)
    return Flat(Problem(present=flat.pop("present", None), **flat), multiplier, batch)


def _contacts(points: AnyArray) -> int:
    shape = np.shape(points)
    if len(shape) < 2 or shape[-1] != 3 or shape[-2] == 0:
        raise ValueError(f"points has shape {shape}: expected (..., n, 3) with at least one contact")
    return shape[-2]


def _precision(*arrays: AnyArray) -> np.dtype:
    """The finest floating-point precision among the arrays: that of integers and plain numbers does not count."""
    floats = [a.dtype for a in map(jnp.asarray, arrays) if jnp.issubdtype(a.dtype, jnp.floating) and not a.weak_type]
    return np.dtype(max(floats, key=lambda d: d.itemsize, default=jnp.asarray(0.0).dtype))


def _leading_axes(name: str, array: Array, tail: tuple[int, ...]) -> tuple[int, ...]:
    if array.shape[max(array.ndim - len(tail), 0) :] != tail:
        raise ValueError(f"{name} has shape {array.shape}: expected (..., {', '.join(map(str, tail))})")
    return array.shape[: array.ndim - len(tail)]


def warn_of_lost_precision(*arguments: Grasp | AnyArray) -> None:
    """Say so where float64 data will be computed in float32; to be called two calls below the user's."""
    given = any(isinstance(a, np.ndarray) and a.dtype == np.float64 for a in jax.tree.leaves(arguments))
    if given and not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "float64 data are computed in float32, since JAX's 64-bit mode is off: "
            "call jax.config.update('jax_enable_x64', True) first, or pass float32 arrays",
            stacklevel=4,
        )
