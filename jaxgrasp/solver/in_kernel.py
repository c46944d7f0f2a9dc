"""Solves a flat batch by the C++ kernel, compiled by NVIDIA Warp: in place of the phases in ``phases.py``.

Programs for processors call it by XLA's foreign function interface; on NVIDIA's GPUs it is a kernel of Warp. Limits of
joint torques and guides are left to the phases.

The kernel is code of this machine. A program that ``jax.export`` lowers has the phases in its place: whether a program
is exported is known where it is lowered, and not where it is traced, so the choice is a primitive.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.experimental.custom_partitioning import custom_partitioning
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import mlir
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrasp.kernel import compiled, gpu
from jaxgrasp.kernel.compiled import CODES, INPUTS, OUTPUTS, Variant
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.solution import Verdict
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver.result import PhaseResult


def unless_exported(function: Callable[[Any], Any], exported: Callable[[Any], Any], argument: Any) -> Any:
    """Return ``function(argument)``; in a program that ``jax.export`` lowers, ``exported(argument)``.

    ``exported`` is traced there alone, and must return a tree of the same arrays. The choice has no derivative and is
    not mapped by ``vmap``: it is called below rules of its own for both.
    """
    leaves, structure = jax.tree.flatten(argument)

    def flat(function: Callable[[Any], Any]) -> Callable[..., list[Any]]:
        return lambda *leaves: jax.tree.leaves(function(jax.tree.unflatten(structure, leaves)))

    traced, shapes = jax.make_jaxpr(lambda *leaves: function(jax.tree.unflatten(structure, leaves)), return_shape=True)(
        *leaves
    )
    results = _choice.bind(*leaves, traced=traced, exported=flat(exported))
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def _lower(context: mlir.LoweringRuleContext, *operands: Any, traced: ClosedJaxpr, exported: Callable) -> Any:
    is_exported = context.module_context.lowering_parameters.for_export
    function = exported if is_exported else jaxpr_as_fun(traced)
    return mlir.lower_fun(function, multiple_results=True)(context, *operands)


_choice = Primitive("unless_exported")
_choice.multiple_results = True
_choice.def_impl(lambda *leaves, traced, exported: jax.jit(jaxpr_as_fun(traced))(*leaves))
_choice.def_abstract_eval(lambda *leaves, traced, exported: traced.out_avals)
mlir.register_lowering(_choice, _lower)


class Wanted(NamedTuple):
    """Solutions to compute."""

    closed_form: bool
    optimum: bool


def has_room_for(contacts: int) -> bool:
    """Return whether the kernel can solve problems of so many contacts."""
    return contacts > 0 and compiled.room_for(contacts) is not None


def supports(problem: ProblemBatch) -> bool:
    """Return whether the kernel can solve a batch: no guide, no torque limits, and room for its contacts."""
    contacts, dtype = problem.points.shape[1], np.dtype(problem.points.dtype)
    return (
        problem.free is None
        and problem.torque_bounds is None
        and has_room_for(contacts)
        and dtype in (np.float32, np.float64)
    )


def _variant(problem: ProblemBatch) -> Variant:
    room = compiled.room_for(problem.points.shape[1])
    assert room is not None
    bounded = problem.normal_min is not None or problem.normal_max is not None
    return Variant(np.dtype(problem.points.dtype).name, room, problem.torsion is not None, bounded)


def _fields(problem: ProblemBatch) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """Return the shape of each result, without the batch, and its dtype."""
    contacts = problem.points.shape[1]
    shapes = {"forces": (contacts, 3), "moments": (contacts,), "normal_multiplier": (contacts,)}
    shapes |= {"multiplier": (6,), "certificate": (6,)}
    real, integer = np.dtype(problem.points.dtype), np.dtype(np.int32)
    return {name: (shapes.get(name, ()), integer if name in CODES else real) for name in OUTPUTS}


def _to_result(problem: ProblemBatch, values: Sequence[Array]) -> PhaseResult:
    """Return the values of ``OUTPUTS`` as a result, without the fields that problems of this kind do not have."""
    fields: dict[str, Any] = dict(zip(OUTPUTS, values, strict=True))
    variant = _variant(problem)
    if not variant.has_soft_fingers:
        fields["moments"] = None
    if not variant.has_bounds:
        fields["normal_multiplier"] = None
    return PhaseResult(
        **fields,
        undecided=fields["verdict"] == Verdict.NOT_CONVERGED,
        strength=jnp.zeros_like(fields["residual"]),
        torque_multiplier=None,
        certificate_rates=None,
    )


def solve_traced(problem: ProblemBatch, wanted: Wanted, phases: Callable[[ProblemBatch], Any]) -> Any:
    """Return the wanted result inside a program, or (closed form, optimum), by the kernel where it supports the batch.

    Which code a program for another platform gets is decided where it is lowered: the kernel on processors and on
    NVIDIA's GPUs, ``phases`` elsewhere and in programs for ``jax.export``, since the kernel is this machine's own code.
    Where JAX has only a processor, and nothing is exported, ``phases`` is not even traced.
    """
    if not supports(problem):
        return phases(problem)

    def by_kernel(problem: ProblemBatch) -> Any:
        on_processor = partial(_on_processor, wanted=wanted)
        if jax.default_backend() == "cpu":
            return on_processor(problem)
        return lax.platform_dependent(problem, cpu=on_processor, cuda=partial(_on_gpu, wanted=wanted), default=phases)

    return unless_exported(by_kernel, phases, problem)


def _one_or_both(results: list[PhaseResult]) -> Any:
    return results[0] if len(results) == 1 else tuple(results)


def _on_processor(problem: ProblemBatch, wanted: Wanted) -> Any:
    dtype = problem.points.dtype
    given = [getattr(problem, name) for name in INPUTS]
    operands = [np.zeros((0, 1), dtype) if array is None else array for array in given]
    target = _target(_variant(problem), wanted.optimum)
    fields = tuple(_fields(problem).values()) * sum(wanted)
    if jax.device_count() == 1 or jax.sharding.get_abstract_mesh().manual_axes:
        values = _call(target, fields, *operands)
    else:
        spread = tuple(array is not None and array.shape[0] != 1 for array in given)
        values = _partitioned_call(target, fields, spread, tuple(array.ndim for array in operands))(*operands)
    count = len(OUTPUTS)
    return _one_or_both([_to_result(problem, values[first : first + count]) for first in range(0, len(values), count)])


Fields = tuple[tuple[tuple[int, ...], np.dtype], ...]
"""Shape without the batch, and dtype, of each result."""


def _call(target: str, fields: Fields, *operands: AnyArray) -> Any:
    size = operands[INPUTS.index("wrench")].shape[0]
    shapes = [jax.ShapeDtypeStruct((size, *shape), dtype) for shape, dtype in fields]
    # Inside shard_map, results vary along the axes along which the data do.
    return varying_like(jax.ffi.ffi_call(target, shapes)(*operands), operands)


@cache
def _partitioned_call(
    target: str, fields: Fields, spread: tuple[bool, ...], ranks: tuple[int, ...]
) -> Callable[..., Any]:
    """Return the call for batches that a mesh spreads over its devices: each solves its own part.

    Args:
        target: name of the function for XLA.
        fields: of the results.
        spread: whether each operand has an entry for each problem, rather than one that all share.
        ranks: numbers of axes of the operands.
    """
    call = partial(_call, target, fields)
    partitioned = custom_partitioning(call)

    def partition(mesh: Mesh, arg_shapes: Any, result_shape: Any) -> tuple:
        batch = (tuple(arg_shapes[INPUTS.index("wrench")].sharding.spec) or (None,))[0]
        over_batch, everywhere = NamedSharding(mesh, PartitionSpec(batch)), NamedSharding(mesh, PartitionSpec())
        operands = tuple(over_batch if is_spread else everywhere for is_spread in spread)
        return mesh, call, [over_batch] * len(fields), operands

    # Einstein's notation of Shardy: all spread operands and all results share the factor b.
    def factors(name: str, rank: int, is_spread: bool) -> str:
        first = "b" if is_spread else f"{name}0"
        return " ".join([first, *(f"{name}{axis}" for axis in range(1, rank))])

    operand_factors = [factors(f"x{i}_", rank, is_spread) for i, (rank, is_spread) in enumerate(zip(ranks, spread))]
    result_factors = [factors(f"y{i}_", 1 + len(shape), True) for i, (shape, _) in enumerate(fields)]
    rule = f"{', '.join(operand_factors)} -> {', '.join(result_factors)}"
    partitioned.def_partition(partition=partition, sharding_rule=rule)
    return partitioned


def _on_gpu(problem: ProblemBatch, wanted: Wanted) -> Any:
    """Return the results by a kernel with a thread for each problem; each solution is a launch of its own."""
    size, contacts = problem.wrench.shape[0], problem.points.shape[1]
    dtype = problem.points.dtype
    given = [getattr(problem, name) for name in INPUTS]
    shared = sum(1 << i for i, array in enumerate(given) if array is not None and array.shape[0] == 1)
    operands = [jnp.zeros(0, dtype) if array is None else array.reshape(-1) for array in given]
    variant = _variant(problem)
    if contacts <= gpu.REGISTER_CONTACTS:
        variant = variant._replace(max_contacts=contacts)
    shapes = {name: (size, *shape) for name, (shape, _) in _fields(problem).items()}
    output_dims = {name: math.prod(shape) for name, shape in shapes.items()}
    results = []
    for is_optimum in (False, True):
        if wanted[is_optimum]:
            values = gpu.jax_kernel(variant)(
                *operands, contacts, shared, int(is_optimum), launch_dims=size, output_dims=output_dims
            )
            shaped = [value.reshape(shape) for value, shape in zip(values, shapes.values(), strict=True)]
            results.append(_to_result(problem, shaped))
    return _one_or_both(results)


@cache
def _target(variant: Variant, has_optimum: bool) -> str:
    """Register the variant's function with XLA and return its name there."""
    optimum, closed_form = compiled.addresses(variant)
    name = f"{variant.name}_{'optimum' if has_optimum else 'closed_form'}"
    address = optimum if has_optimum else closed_form
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")
    return name


@cache
def _pullback_target(variant: Variant) -> str:
    """Register the function of the variant's derivatives with XLA and return its name there."""
    (address,) = compiled.addresses(variant, compiled.PULLBACK)
    name = f"{variant.name}_pullback"
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")
    return name


MOVING = ("points", "normals", "friction", "squeeze", "wrench", "weights", "torsion", "normal_min", "normal_max")
"""Fields of a problem on which the answer depends, in the order of ``ProblemCotangents`` in pullback.h."""
ANSWER = ("forces", "multiplier", "verdict")
"""Fields of a solution from which derivatives are computed."""
MOVED = ("forces", "multiplier", "objective", "moments", "normal_multiplier")
"""Fields of a solution that have derivatives, in the order of ``AnswerCotangents`` in pullback.h."""


def supports_pullback(problem: ProblemBatch) -> bool:
    """Return whether the kernel can compute the derivatives of a batch: on one processor, outside of ``shard_map``."""
    is_alone = jax.default_backend() == "cpu" and jax.device_count() == 1
    return is_alone and not jax.sharding.get_abstract_mesh().manual_axes and supports(problem)


def pull_back(
    problem: ProblemBatch, answer: Sequence[Array], cotangents: Sequence[Array | None], constrained: bool
) -> tuple[dict[str, Array], Array]:
    """Return the derivatives by each field of ``MOVING`` that the problem has, and whether there are any ``(B,)``.

    Args:
        problem: whose arrays all have an entry for each problem.
        answer: its ``ANSWER``.
        cotangents: of ``MOVED``, None for what solutions of this kind do not have; or none at all, to ask only whether
            there are derivatives.
        constrained: whether the answer is the optimum, or the closed form.
    """
    dtype, size = problem.points.dtype, problem.wrench.shape[0]
    inputs = [None if name == "start" else getattr(problem, name) for name in INPUTS]
    given = [*inputs, *answer, *(cotangents or [None] * len(MOVED)), np.array([constrained], np.int32)]
    operands = [np.zeros((0, 1), dtype) if array is None else array for array in given]
    fields = {name: getattr(problem, name) if cotangents else None for name in MOVING}
    shapes = [jax.ShapeDtypeStruct((0, 1) if x is None else x.shape, dtype) for x in fields.values()]
    shapes.append(jax.ShapeDtypeStruct((size,), np.int32))
    *results, has_derivatives = jax.ffi.ffi_call(_pullback_target(_variant(problem)), shapes)(*operands)
    by_field = {name: array for name, array in zip(fields, results, strict=True) if fields[name] is not None}
    return by_field, has_derivatives != 0
