"""Forces and margins for PyTorch: tensors in, tensors out, gradients by ``backward`` (extra ``torch``).

Tensors and arrays share their memory by DLPack, on a GPU too; nothing is copied but what is not contiguous, or on a CPU
not aligned as XLA asks. JAX compiles for each new shape, for some seconds; float64 needs JAX's 64-bit mode::

    from jaxgrasp.interop import torch as grasp_torch
    held = grasp_torch.constrained_optimum(points, normals, friction, squeeze, wrench)
    held.forces.square().sum().backward()
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import distribution, margin, slip
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.flatten import read_sharing_name
from jaxgrasp.validation.optional_library import optional_library

if TYPE_CHECKING:
    from torch import Tensor

Sharing = Literal["squeeze", "uniform", "A", "B"]


class TensorForces(NamedTuple):
    """Forces of a grasp, and what they are worth."""

    forces: Tensor
    """``(..., n, 3)`` [N]"""
    verdict: Tensor
    """``(...)`` codes of [`jaxgrasp.Verdict`][]; those below 2 are answers."""


def constrained_optimum(
    points: Tensor,
    normals: Tensor,
    friction: Tensor | float,
    squeeze: Tensor | float,
    wrench: Tensor,
    *,
    present: Tensor | None = None,
    sharing: Sharing = "squeeze",
) -> TensorForces:
    """Compute the forces of [`jaxgrasp.constrained_optimum`][], differentiable once by every tensor.

    Where no forces exist, gradients are NaN for whatever asks for them: mask such problems by the verdict.

    Args:
        points, normals: of the contacts ``(..., n, 3)`` [m]; unit normals into the object.
        friction, squeeze: ``(..., n)``, or one number for all; squeeze in [N].
        wrench: to exert ``(..., 6)`` [N, N.m].
        present: ``(..., n)``, 1 where there is a contact and 0 where not; all where not given.
        sharing: ``"squeeze"`` or ``"B"`` is the paper's method B, ``"uniform"`` or ``"A"`` its method A.

    Raises:
        ImportError: without PyTorch.
        TypeError: for what is no tensor, or tensors of different kinds.
        ValueError: for shapes that do not fit, or float64 where JAX's 64-bit mode is off.
    """
    return TensorForces(*_forces("constrained_optimum", sharing, points, normals, friction, squeeze, wrench, present))


def closed_form(
    points: Tensor,
    normals: Tensor,
    friction: Tensor | float,
    squeeze: Tensor | float,
    wrench: Tensor,
    *,
    present: Tensor | None = None,
    sharing: Sharing = "squeeze",
) -> TensorForces:
    """Compute the forces of [`jaxgrasp.closed_form`][], without friction cones; arguments as for the optimum."""
    return TensorForces(*_forces("closed_form", sharing, points, normals, friction, squeeze, wrench, present))


def wrench_margin(
    points: Tensor,
    normals: Tensor,
    friction: Tensor | float,
    wrench: Tensor,
    direction: Tensor,
    *,
    present: Tensor | None = None,
) -> Tensor:
    """Compute the largest multiple of a direction that the cones hold beside a wrench: [`jaxgrasp.wrench_margin`][].

    Args:
        points, normals, friction, wrench, present: as for the optimum.
        direction: of the wrench to be added ``(..., 6)``.

    Returns:
        ``(...)``, in units of the direction.
    """
    tensors = _grasp_tensors(points, normals, friction, 1.0, present)
    return _margin_of_wrench()(tensors, wrench, direction)


def stability_margin(normals: Tensor, forces: Tensor) -> Tensor:
    """Compute each contact's margin, 90 degrees less its slip angle [rad]: [`jaxgrasp.stability_margin`][].

    Args:
        normals: of the contacts ``(..., n, 3)``, into the object.
        forces: on the object ``(..., n, 3)`` [N].

    Returns:
        ``(..., n)``; negative where a contact pulls.
    """
    return _margin_of_forces()(normals, forces)


def from_jax(function: Callable[..., Any]) -> Callable[..., Any]:
    """Convert a function of JAX arrays to a function of tensors, with gradients by ``backward``.

    The function is compiled for each shape of its arguments, and differentiated by JAX in reverse, once. Its arguments
    and results may be trees of arrays, such as tuples and dictionaries; results that are no floats have no gradient.

    Args:
        function: of arrays, that ``jax.jit`` can compile. Keep what this returns: what is compiled is kept with it.

    Returns:
        The function, on trees of tensors.

    Raises:
        ImportError: without PyTorch.
    """
    torch, bridge, compiled = _torch(), _bridge(), _Compiled(function)

    def call(*arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        for leaf in leaves:
            if not isinstance(leaf, torch.Tensor):
                raise TypeError(f"an argument is of type {type(leaf).__name__}: expected torch tensors")
        _check_alike(leaves)
        structures: list[Any] = []
        results = bridge.apply(compiled, structure, structures, *leaves)
        return jax.tree.unflatten(structures[0], results)

    return call


def to_jax(tensor: Tensor) -> Array:
    """Return an array that shares a tensor's memory; a copy only where that is not contiguous, or not aligned.

    Raises:
        ValueError: for float64 where JAX's 64-bit mode is off.
    """
    if str(tensor.dtype) in ("torch.float64", "torch.int64") and not jax.config.read("jax_enable_x64"):
        raise ValueError(
            f"a tensor is of {tensor.dtype} while JAX's 64-bit mode is off: call "
            "jax.config.update('jax_enable_x64', True) first, or pass float32"
        )
    return jnp.from_dlpack(tensor.detach().contiguous())


def to_torch(array: Array) -> Tensor:
    """Return a tensor that shares an array's memory. JAX takes its arrays for constant: do not write into it."""
    return _torch().from_dlpack(array)


def _torch() -> Any:
    """Import PyTorch, or raise an error that says how to install it."""
    return optional_library("torch", missing="jaxgrasp.interop.torch needs PyTorch: pip install 'jaxgrasp[torch]'")


def _check_alike(tensors: list[Tensor]) -> None:
    """Check that all floats have one dtype and one device: neither library names the tensor that differs."""
    dtypes = {(str(t.dtype), str(t.device)) for t in tensors if t.dtype.is_floating_point}
    if len(dtypes) > 1:
        listed = " and ".join(" on ".join(pair) for pair in sorted(dtypes))
        raise TypeError(f"the tensors are of {listed}: expected one kind on one device")


def _forces(method: str, sharing: str, *arguments: Any) -> tuple[Tensor, Tensor]:
    sharing = read_sharing_name(sharing)
    points, normals, friction, squeeze, wrench, present = arguments
    return _solver(method, sharing)(_grasp_tensors(points, normals, friction, squeeze, present), wrench)


def _grasp_tensors(points: Any, normals: Any, friction: Any, squeeze: Any, present: Any) -> dict[str, Tensor]:
    """Collect the fields of a Grasp as tensors; numbers become tensors."""
    torch = _torch()
    if not isinstance(points, torch.Tensor):
        raise TypeError(f"points is of type {type(points).__name__}: expected a torch tensor")
    tensors = {"points": points, "normals": normals, "friction": friction, "squeeze": squeeze, "present": present}
    tensors = {name: value for name, value in tensors.items() if value is not None}
    if not points.is_floating_point():
        raise TypeError(f"points is of {points.dtype}: expected floats")
    for name in ("friction", "squeeze"):
        if isinstance(tensors[name], (int, float)):
            tensors[name] = points.new_full(points.shape[:-1], float(tensors[name]))
    for name, value in tensors.items():
        if not isinstance(value, torch.Tensor):
            raise TypeError(f"{name} is of type {type(value).__name__}: expected a torch tensor")
        if name != "present" and not value.is_floating_point():
            raise TypeError(f"{name} is of {value.dtype}: expected floats")
    return tensors


@cache
def _solver(method: str, sharing: str) -> Callable[..., Any]:
    answer = getattr(distribution, method)

    def solve(grasp: dict[str, Array], wrench: Array) -> tuple[Array, Array]:
        solution = answer(Grasp(**grasp), wrench, sharing)
        return solution.forces, solution.verdict

    return from_jax(solve)


@cache
def _margin_of_wrench() -> Callable[..., Any]:
    return from_jax(lambda grasp, wrench, direction: margin.wrench_margin(Grasp(**grasp), wrench, direction))


@cache
def _margin_of_forces() -> Callable[..., Any]:
    def margin_of(normals: Array, forces: Array) -> Array:
        nothing = jnp.zeros_like(normals[..., 0])
        return slip.stability_margin(Grasp(jnp.zeros_like(normals), normals, nothing, nothing), forces)

    return from_jax(margin_of)


class _Compiled:
    """A function of arrays, compiled alone and with its derivative."""

    def __init__(self, function: Callable[..., Any]):
        self.function = function
        self.plain = jax.jit(self._plain, static_argnums=0)
        self.with_pullback = jax.jit(self._with_pullback, static_argnums=(0, 1))

    def _plain(self, structure: Any, leaves: list[Array]) -> Any:
        return self.function(*jax.tree.unflatten(structure, leaves))

    def _with_pullback(self, structure: Any, differentiated: tuple[int, ...], leaves: list[Array]) -> Any:
        """Return the result and a pullback from cotangents of its floats to cotangents of the wanted leaves."""

        def floats(*variables: Array) -> tuple[list[Array], Any]:
            inputs = list(leaves)
            for index, leaf in zip(differentiated, variables, strict=True):
                inputs[index] = leaf
            result = self._plain(structure, inputs)
            return [leaf for leaf in jax.tree.leaves(result) if jnp.issubdtype(leaf.dtype, jnp.floating)], result

        _, pullback, result = jax.vjp(floats, *(leaves[i] for i in differentiated), has_aux=True)
        return result, pullback


@jax.jit
def _pull(pullback: Any, cotangents: list[Array]) -> tuple[Array, ...]:
    return pullback(cotangents)


def _apart_from(tensors: tuple[Tensor, ...]) -> Callable[[Array], Tensor]:
    """Return a converter to tensors with memory of their own: a result passed through shares an argument's."""
    taken = {tensor.data_ptr() for tensor in tensors}

    def convert(array: Array) -> Tensor:
        tensor = to_torch(array)
        return tensor.clone() if tensor.data_ptr() in taken else tensor

    return convert


@cache
def _bridge() -> Any:
    """Create the ``torch.autograd.Function`` when PyTorch is first asked for."""
    torch = _torch()

    class JaxFunction(torch.autograd.Function):  # type: ignore[name-defined]
        """A compiled function of arrays on leaves of its arguments; which floats need gradients decides what runs."""

        @staticmethod
        def forward(
            ctx: Any, compiled: _Compiled, structure: Any, structures: list, *tensors: Tensor
        ) -> tuple[Tensor, ...]:
            leaves = [to_jax(tensor) for tensor in tensors]
            differentiated = tuple(i for i, needed in enumerate(ctx.needs_input_grad[3:]) if needed)
            if differentiated:
                result, ctx.pullback = compiled.with_pullback(structure, differentiated, leaves)
            else:
                result = compiled.plain(structure, leaves)
            ctx.differentiated, ctx.count = differentiated, len(tensors)
            arrays, result_structure = jax.tree.flatten(result)
            structures.append(result_structure)
            results = tuple(map(_apart_from(tensors), arrays))
            # The pullback reads their memory: PyTorch refuses to go back where they have been written to since.
            ctx.save_for_backward(*tensors, *results)
            ctx.mark_non_differentiable(*(tensor for tensor in results if not tensor.dtype.is_floating_point))
            return results

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
            _ = ctx.saved_tensors
            cotangents = [
                to_jax(gradient) for gradient in gradients if gradient is not None and gradient.dtype.is_floating_point
            ]
            pulled = _pull(ctx.pullback, cotangents)
            input_gradients: list[Tensor | None] = [None] * ctx.count
            for index, gradient in zip(ctx.differentiated, pulled, strict=True):
                input_gradients[index] = to_torch(gradient)
            return (None, None, None, *input_gradients)

    return JaxFunction
