"""The derivative of ``derivative.py`` on one processor: tangents, their transpose, and the mask of where there are any.

Each is a primitive of a flat batch, computed in tiles that stay in the cache, by one fused kernel. Where the C++ kernel
solves, reverse mode is that kernel's too, and compiles no more than a call of it. Derivatives of second order and
programs for ``jax.export`` take the rule in JAX as it is, to the same numbers but for rounding.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxgrasp.model.solution import Solution
from jaxgrasp.numerics.compiled_code import is_known_xla, traced_for_here
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import derivative, in_kernel
from jaxgrasp.solver.derivative import Tangent
from jaxgrasp.solver.in_kernel import ANSWER, MOVED, MOVING
from jaxgrasp.solver.phases import newton_width

LEAST_TILED = 1000
"""Problems from which on the primitives compute derivatives where the C++ kernel does not: in a fiftieth of the time at
5000 problems, in a quarter at 500, where compiling takes twice as long."""
DATA = (*MOVING, "present")
"""Fields of a problem that the derivative is computed from."""


class _Layout(NamedTuple):
    """Names of the operands of the primitives: a problem's data, an answer, then tangents or cotangents."""

    data: tuple[str, ...]
    moved: tuple[str, ...]
    """Fields of a solution of this kind that have derivatives."""
    constrained: bool
    is_by_kernel: bool
    """Whether the C++ kernel computes what it can."""

    @property
    def moving(self) -> tuple[str, ...]:
        return tuple(name for name in self.data if name in MOVING)

    @property
    def fixed_count(self) -> int:
        """Number of operands before the tangents or cotangents."""
        return len(self.data) + len(ANSWER)

    def arrays(self, operands: Sequence[Any]) -> dict[str, Any]:
        """Return the operands that are the problem's data, by name."""
        return dict(zip(self.data, operands, strict=False))

    def problem(self, operands: Sequence[Array]) -> ProblemBatch:
        """Return the problem of the operands."""
        return ProblemBatch(**{"present": None, **self.arrays(operands)})

    def answer(self, operands: Sequence[Any]) -> Sequence[Any]:
        """Return the arrays ``ANSWER`` of the operands."""
        return operands[len(self.data) : self.fixed_count]


def tangent(
    problem: ProblemBatch, moved: ProblemBatch, solution: Solution, constrained: bool, *, is_by_kernel: bool = False
) -> Tangent:
    """Return what ``derivative.tangent`` returns, by the primitives where they support the problem.

    ``is_by_kernel`` says whether the C++ kernel computes the transpose where it can.
    """
    is_by_kernel = is_by_kernel and in_kernel.supports_pullback(problem)
    if not is_by_kernel and not _supports(problem):
        return derivative.tangent(problem, moved, solution, constrained)
    data = tuple(name for name in DATA if getattr(problem, name) is not None)
    names = tuple(name for name in MOVED if getattr(solution, name) is not None)
    layout = _Layout(data, names, constrained, is_by_kernel)

    # The primitives know no grasp that many wrenches share.
    def spread(array: Array) -> Array:
        return jnp.broadcast_to(array, (problem.size, *array.shape[1:]))

    fixed = [spread(getattr(problem, name)) for name in data] + [getattr(solution, name) for name in ANSWER]
    tangents = _tangent.bind(*fixed, *(spread(getattr(moved, name)) for name in layout.moving), layout=layout)
    (has_derivatives,) = _exists.bind(*map(jax.lax.stop_gradient, fixed), layout=layout)
    fields: dict[str, Any] = dict.fromkeys(Tangent._fields) | dict(zip(names, tangents, strict=True))
    return Tangent(**fields | {"undefined": ~has_derivatives})


def _supports(problem: ProblemBatch) -> bool:
    """Return whether the primitives compute a batch's derivatives: on one processor, outside of ``shard_map``.

    Guides and limits of torques are left to the rule as it is; and so are small batches, for which it compiles in half
    of the time.
    """
    contacts = problem.points.shape[1]
    return (
        is_known_xla()
        and jax.device_count() == 1
        and not jax.sharding.get_abstract_mesh().manual_axes
        and problem.free is None
        and problem.torque_bounds is None
        and contacts > 0
        and problem.size >= LEAST_TILED
    )


def _tangent_in_jax(*operands: Array, layout: _Layout) -> list[Array]:
    return _tangent_and_mask(*operands, layout=layout)[0]


def _tangent_and_mask(*operands: Array, layout: _Layout) -> tuple[list[Array], Array]:
    problem = layout.problem(operands)
    forces, multiplier, verdict = layout.answer(operands)
    zero, code = jnp.zeros(verdict.shape, forces.dtype), jnp.zeros_like(verdict)
    # What the derivative does not read is zero.
    unread = {"residual": zero, "objective": zero, "force_bound": zero, "certificate": jnp.zeros_like(multiplier)}
    unread |= {"steps": code, "route": code, "rank": code}
    solution = Solution(forces=forces, multiplier=multiplier, verdict=verdict, **unread)
    moved: dict[str, Any] = dict(zip(layout.moving, operands[layout.fixed_count :], strict=True))
    moved["present"] = None if problem.present is None else jnp.zeros_like(problem.present)
    parts = derivative.tangent(problem, ProblemBatch(**moved), solution, layout.constrained)
    return [getattr(parts, name) for name in layout.moved], parts.undefined


def _pull_in_jax(*operands: Array, layout: _Layout) -> list[Array]:
    fixed, cotangents = operands[: layout.fixed_count], operands[layout.fixed_count :]
    zeros = [jnp.zeros_like(layout.arrays(fixed)[name]) for name in layout.moving]
    _, pull = jax.vjp(lambda *moved: _tangent_in_jax(*fixed, *moved, layout=layout), *zeros)
    return list(pull(list(cotangents)))


def _pull_by_kernel(*operands: Array, layout: _Layout) -> list[Array]:
    given = dict(zip(layout.moved, operands[layout.fixed_count :], strict=True))
    cotangents = [given.get(name) for name in MOVED]
    problem, answer = layout.problem(operands), layout.answer(operands)
    by_field, _ = in_kernel.pull_back(problem, answer, cotangents, layout.constrained)
    return [by_field[name] for name in layout.moving]


def _exists_in_jax(*operands: Array, layout: _Layout) -> list[Array]:
    zeros = [jnp.zeros_like(layout.arrays(operands)[name]) for name in layout.moving]
    return [~_tangent_and_mask(*operands, *zeros, layout=layout)[1]]


def _exists_by_kernel(*operands: Array, layout: _Layout) -> list[Array]:
    problem, answer = layout.problem(operands), layout.answer(operands)
    return [in_kernel.pull_back(problem, answer, (), layout.constrained)[1]]


def _tangent_shapes(*operands: Any, layout: _Layout) -> list[Any]:
    data = layout.arrays(operands)
    shapes = {
        "forces": data["points"].shape,
        "multiplier": data["wrench"].shape,
        "objective": data["wrench"].shape[:1],
        "moments": data["friction"].shape,
        "normal_multiplier": data["friction"].shape,
    }
    return [data["points"].update(shape=shapes[name], weak_type=False) for name in layout.moved]


def _pulled_shapes(*operands: Any, layout: _Layout) -> list[Any]:
    data = layout.arrays(operands)
    return [data[name].update(weak_type=False) for name in layout.moving]


def _exists_shapes(*operands: Any, layout: _Layout) -> list[Any]:
    (*_, verdict) = layout.answer(operands)
    return [verdict.update(dtype=jnp.dtype(bool), weak_type=False)]


def _primitive(name: str, in_jax: Callable, by_kernel: Callable | None, shapes: Callable) -> Primitive:
    """Return a primitive of a flat batch, whose derivatives are those of its function in JAX."""
    primitive = Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(lambda *operands, layout: jax.jit(partial(primitive.bind, layout=layout))(*operands))
    primitive.def_abstract_eval(shapes)

    tile = fused_cpu_kernel(in_jax)

    def in_tiles(*operands: Array, layout: _Layout) -> list[Array]:
        size, contacts = operands[layout.data.index("friction")].shape
        function = lambda part: tile(*part, layout=layout)  # noqa: E731
        return over_tiles(function, list(operands), size, newton_width(contacts))

    def lower(context: mlir.LoweringRuleContext, *operands: Any, layout: _Layout) -> Any:
        if context.module_context.lowering_parameters.for_export:
            function = in_jax
        elif layout.is_by_kernel and by_kernel is not None:
            function = by_kernel
        else:
            function = traced_for_here(in_tiles)
        return mlir.lower_fun(partial(function, layout=layout), multiple_results=True)(context, *operands)

    # Not cacheable, as the marks of fused kernels are not.
    mlir.register_lowering(primitive, lower, cacheable=False)

    def jvp(primals: Sequence[Array], tangents: Sequence[Any], layout: _Layout) -> tuple[Any, Any]:
        results = primitive.bind(*primals, layout=layout)
        last = layout.fixed_count
        if all(isinstance(tangent, ad.Zero) for tangent in tangents[:last]) and len(tangents) > last:
            # Linear in the rest.
            moved = map(ad.instantiate_zeros, tangents[last:])
            return results, primitive.bind(*primals[:last], *moved, layout=layout)
        moves = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero)]

        def of_moving(*moving: Array) -> list[Array]:
            operands = list(primals)
            for i, array in zip(moves, moving, strict=True):
                operands[i] = array
            return in_jax(*operands, layout=layout)

        _, moved = jax.jvp(of_moving, [primals[i] for i in moves], [tangents[i] for i in moves])
        return results, moved

    ad.primitive_jvps[primitive] = jvp

    def mapped(operands: Sequence[Array], axes: Sequence[int | None], layout: _Layout) -> tuple[Any, list[int]]:
        if by_kernel is None and all(axis is None for axis in axes[: layout.fixed_count]):
            # Many tangents of one problem, as of a Jacobian in forward mode: the problem's own work is done once.
            results = jax.vmap(partial(in_jax, layout=layout), axes)(*operands)
            return results, [0] * len(results)
        size = next(x.shape[axis] for x, axis in zip(operands, axes, strict=True) if axis is not None)

        def merge(array: Array, axis: int | None) -> Array:
            wide = jnp.broadcast_to(array[None], (size, *array.shape)) if axis is None else jnp.moveaxis(array, axis, 0)
            return wide.reshape(size * wide.shape[1], *wide.shape[2:])

        results = primitive.bind(*map(merge, operands, axes), layout=layout)
        return [x.reshape(size, x.shape[0] // size, *x.shape[1:]) for x in results], [0] * len(results)

    batching.primitive_batchers[primitive] = mapped
    return primitive


_tangent = _primitive("grasp_tangent", _tangent_in_jax, None, _tangent_shapes)
"""Tangents of the fields of a solution, linear in the last operands."""
_pullback = _primitive("grasp_pullback", _pull_in_jax, _pull_by_kernel, _pulled_shapes)
"""Its transpose by them."""
_exists = _primitive("grasp_has_derivatives", _exists_in_jax, _exists_by_kernel, _exists_shapes)
"""Mask ``(B,)`` of the answers that have derivatives."""


def _transposed(cotangents: Sequence[Any], *operands: Any, layout: _Layout) -> list[Any]:
    given = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    pulled = _pullback.bind(*operands[: layout.fixed_count], *given, layout=layout)
    moved = operands[layout.fixed_count :]
    wanted = [x if ad.is_undefined_primal(operand) else None for x, operand in zip(pulled, moved, strict=True)]
    return [None] * layout.fixed_count + wanted


ad.primitive_transposes[_tangent] = _transposed
