"""Other code for programs that ``jax.export`` lowers: what calls this machine's own code cannot run elsewhere.

Whether a program is exported is known where it is lowered, and not where it is traced, so the choice is a primitive.
"""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import mlir


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
