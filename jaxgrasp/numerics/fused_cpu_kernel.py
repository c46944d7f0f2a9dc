"""Functions that XLA compiles for the processor as one kernel each.

XLA makes a kernel of every few operations. Each takes about 20 ms to compile, and 0.1 us to call: on a tile of 16
problems more than its arithmetic. A call that carries two attributes, which XLA itself gives to small loops, is
compiled as one kernel instead, by an emitter that is faster too.

How large? Compiling grows faster than the code in one kernel, so a step of an algorithm is about right, with up to
some hundred operations. What spans a whole batch is better left alone: a kernel runs on one thread.

From JAX 0.12 on XLA makes one kernel of every loop by itself, with all the code in it. A loop over tiles is so much
code that it then compiles and runs for up to twice as long: it is kept in several kernels (``keep_separate``).

The attributes are XLA's own, and another version may read them otherwise: where ``is_known_xla`` does not know it, all
stay plain functions, of the same answers but for rounding.
"""

from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache, reduce, wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_batching import custom_vmap
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Primitive
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func
from jax.extend.mlir.dialects import stablehlo as hlo
from jax.interpreters import ad, batching, mlir

from jaxgrasp.numerics.compiled_code import is_known_xla, merges_loops

Params = ParamSpec("Params")
Out = TypeVar("Out")
Tree = TypeVar("Tree")

ATTRIBUTES = {"inlineable": "false", "xla_cpu_small_call": "true"}

FOREIGN = (
    *("approx_top_k", "conv_general", "dot_general", "fft", "ffi_call", "io_callback", "pure_callback", "ragged_dot"),
    *("scatter", "sort", "top_k", "cholesky", "eig", "geqp3", "geqrf", "householder", "lu", "ormqr", "schur", "svd"),
    *("triangular_solve", "tridiagonal"),
)
"""How the names begin of what may become a call of a library, which such a kernel cannot hold."""
LARGEST_REDUCTION = 4095
"""Elements; a larger reduction may become the call of a library."""
CALLED = (ClosedJaxpr, Jaxpr)
_is_in_kernel: ContextVar[bool] = ContextVar("is_in_kernel", default=False)
"""Whether what is being traced becomes a kernel."""


def fused_cpu_kernel(function: Callable[Params, Out]) -> Callable[Params, Out]:
    """Return ``function``, compiled as one kernel.

    It stays as it is where XLA is not known to do so, where it is differentiated or mapped, and where it holds what
    such a kernel cannot. Its arguments are trees of arrays and of what can be hashed; it closes over no array.
    """

    @wraps(function)
    def call(*args: Params.args, **kwargs: Params.kwargs) -> Out:
        leaves, tree = jax.tree.flatten((args, kwargs))
        arrays = tuple(leaf for leaf in leaves if _is_array(leaf))
        # With its type, since 1, 1.0 and True are equal.
        fixed = tuple(None if _is_array(leaf) else (type(leaf), leaf) for leaf in leaves)
        # Each array is read, and of one without elements nothing can be.
        if not (is_known_xla() and arrays and all(array.size for array in arrays)):
            return function(*args, **kwargs)
        return _kernel(function, tree, fixed)(*arrays)

    return call


@cache
def _kernel(function: Callable, tree: Any, fixed: tuple) -> Callable:
    """Return the function of the arrays alone, in a tree whose other leaves are ``fixed``."""

    def arguments(arrays: tuple[Array, ...]) -> Any:
        remaining = iter(arrays)
        return jax.tree.unflatten(tree, [next(remaining) if leaf is None else leaf[1] for leaf in fixed])

    def plain(*arrays: Array) -> Any:
        args, kwargs = arguments(arrays)
        return function(*args, **kwargs)

    def touching(*arrays: Array) -> tuple[Any, Array]:
        args, kwargs = arguments(arrays)
        token = _is_in_kernel.set(True)
        try:
            return function(*args, **kwargs), _touch(arrays)
        finally:
            _is_in_kernel.reset(token)

    touching.__name__ = function.__name__
    compiled = jax.jit(touching)

    @custom_vmap
    def alone(*arrays: Array) -> Any:
        if not _fits(compiled.trace(*arrays).jaxpr):
            return plain(*arrays)
        # Behind a barrier, since XLA puts what it knows into a kernel's computation, and so leaves arguments unused.
        out, touched = compiled(*lax.optimization_barrier(arrays))
        # The barrier keeps the second result, and with it the attributes.
        return lax.optimization_barrier((out, _mark.bind(touched)))[0]

    @alone.def_vmap
    def mapped(axis_size: int, in_batched: list[bool], *arrays: Array) -> tuple[Any, Any]:
        out = jax.vmap(plain, [0 if batched else None for batched in in_batched])(*arrays)
        return out, jax.tree.map(lambda _: True, out)

    kernel = jax.custom_jvp(alone)

    @kernel.defjvp
    def jvp(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
        return jax.jvp(plain, primals, tangents)

    return kernel


_mark = Primitive("fused_cpu_kernel")
"""Its operand, whose call gets the attributes."""
_mark.def_impl(lambda touched: touched)
_mark.def_abstract_eval(lambda touched: touched)


def _lower_mark(context: mlir.LoweringRuleContext, touched: Any) -> Any:
    module = context.module_context
    if tuple(module.platforms) == ("cpu",) and not _is_spread(module.axis_context):
        touched.owner.attributes["mhlo.frontend_attributes"] = _attributes()
    return [touched]


# Not cacheable: in a lowering that is kept, the operand would be an argument, and no call.
mlir.register_lowering(_mark, _lower_mark, cacheable=False)


def keep_separate(index: Array) -> Array:
    """Return a loop's ``index`` ``()`` as it is, in a way that keeps XLA from making one kernel of the whole loop.

    Called in the loop's body. XLA leaves a loop that holds a sort in several kernels, so two numbers are sorted, once a
    turn: some 0.3 us. Where XLA does not merge loops, and on other platforms, nothing is done.
    """
    return _separate.bind(index) if merges_loops() else index


_separate = Primitive("keep_separate")
_separate.def_impl(lambda index: index)
_separate.def_abstract_eval(lambda index: index)
batching.primitive_batchers[_separate] = lambda indices, axes: (_separate.bind(*indices), axes[0])


def _lower_separate(context: mlir.LoweringRuleContext, index: Any) -> Any:
    module = context.module_context
    if tuple(module.platforms) != ("cpu",) or _is_spread(module.axis_context):
        return [index]
    # Numbers that differ and are not in order, since a sort that changes nothing is left out.
    smaller = mlir.lower_fun(lambda i: lax.sort(jnp.stack([i + 1, i]))[0], multiple_results=False)
    return smaller(context, index)


mlir.register_lowering(_separate, _lower_separate, cacheable=False)


def computed_once(tree: Tree) -> Tree:
    """Return a tree of arrays as it is, in a way that keeps XLA from computing them anew in each loop that reads them.

    XLA puts cheap operations into every loop that reads their results, and what those read in turn: each of 21 sums of
    products would compute all factors. What this function returns is read from memory instead: worth its loop where
    much work goes into it and many loops read it. Numbers that are not floating are left alone, and outside of a kernel
    nothing is done.
    """
    return jax.tree.map(_once.bind, tree) if _is_in_kernel.get() else tree


_once = Primitive("computed_once")
_once.def_impl(lambda array: array)
_once.def_abstract_eval(lambda array: array)
batching.primitive_batchers[_once] = lambda arrays, axes: (_once.bind(*arrays), axes[0])
ad.deflinear2(_once, lambda cotangent, array: [_once.bind(cotangent)])


def _lower_once(context: mlir.LoweringRuleContext, array: Any) -> Any:
    module = context.module_context
    aval: Any = context.avals_in[0]
    is_float = jnp.issubdtype(aval.dtype, jnp.floating)
    if tuple(module.platforms) != ("cpu",) or _is_spread(module.axis_context) or not is_float:
        return [array]
    # XLA fuses nothing across calls. The function's one operation keeps all digits: XLA drops it only where it is asked
    # for exactly as many as there are. Without it the result would share the argument's memory, and with JAX 0.12
    # what is written in place later then overwrites it.
    kind = array.type
    with ir.InsertionPoint.at_block_begin(module.module.body):
        once = func.FuncOp("computed_once", ir.FunctionType.get([kind], [kind]))
        once.attributes["sym_visibility"] = ir.StringAttr.get("private")
        module.symbol_table.insert(once)
        block = once.body.blocks.append(kind)
    info = jnp.finfo(aval.dtype)
    with ir.InsertionPoint(block):
        kept = hlo.reduce_precision(
            block.arguments[0],
            ir.IntegerAttr.get(ir.IntegerType.get_signless(32), info.nexp),
            ir.IntegerAttr.get(ir.IntegerType.get_signless(32), info.nmant + 8),
        )
        func.ReturnOp([kept])
    call = func.CallOp([kind], ir.FlatSymbolRefAttr.get(ir.StringAttr(once.attributes["sym_name"]).value), [array])
    call.operation.attributes["mhlo.frontend_attributes"] = _attributes()
    return list(call.results)


mlir.register_lowering(_once, _lower_once, cacheable=False)


def _attributes() -> ir.DictAttr:
    return ir.DictAttr.get({name: ir.StringAttr.get(text) for name, text in ATTRIBUTES.items()})


def _is_spread(axes: Any) -> bool:
    """Return whether XLA may spread the program over several devices.

    It would put sums over all devices into a kernel, which cannot hold them. In a ``shard_map`` over all axes each
    device runs the same program by itself."""
    manual = getattr(axes, "manual_axes", None)
    if manual is not None:
        return set(manual) != set(axes.mesh.axis_names)
    return (getattr(axes, "num_devices", 1) or 1) > 1


def _touch(arrays: tuple[Array, ...]) -> Array:
    """Return a number that depends on every argument: XLA aborts where a kernel leaves an argument unused.

    Arrays of one rank and dtype are added first: of a chain of reshaped terms XLA moves one reshape in each pass over
    the program, and gives up after 50 passes.
    """
    sums: dict[tuple, Array] = {}
    for array in arrays:
        kind = array.ndim, array.dtype
        first = lax.slice(array, (0,) * array.ndim, (1,) * array.ndim)
        if array.dtype == bool:
            sums[kind] = lax.bitwise_xor(sums[kind], first) if kind in sums else first
        else:
            sums[kind] = lax.add(sums[kind], first) if kind in sums else first
    firsts = (lax.convert_element_type(lax.squeeze(first, range(first.ndim)), jnp.float32) for first in sums.values())
    return reduce(lax.add, firsts)


def _fits(jaxpr: ClosedJaxpr) -> bool:
    """Return whether all equations can stand in one kernel."""
    return not any(_is_foreign(equation) for equation in _equations(jaxpr.jaxpr))


def _is_foreign(equation: JaxprEqn) -> bool:
    name = equation.primitive.name
    large = any(getattr(variable.aval, "size", 0) > LARGEST_REDUCTION for variable in equation.invars)
    return name.startswith(FOREIGN) or (large and name.startswith(("reduce_", "arg", "cum")))


def _equations(jaxpr: Jaxpr) -> Iterator[JaxprEqn]:
    """Yield the equations of a jaxpr, and those of the functions that they call."""
    for equation in jaxpr.eqns:
        yield equation
        for parameter in equation.params.values():
            for inner in parameter if isinstance(parameter, tuple) else (parameter,):
                if isinstance(inner, CALLED):
                    yield from _equations(inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner)


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray)
