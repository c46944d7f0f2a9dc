"""Array types of the public surface, whose names in signatures are short: ``Float[Array, '... n 3']``."""

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    AnyArray = jax.Array | np.ndarray
else:

    class _Kind(type):
        """The metaclass of array types by the classes whose instances they stand for."""

        stands_for: tuple[type, ...]

        def __instancecheck__(cls, instance: Any) -> bool:
            return isinstance(instance, cls.stands_for)

    # Two names, since type checkers at run time tell hints apart by what they print.
    AnyArray = _Kind("Array", (), {"stands_for": (jax.Array, np.ndarray), "__module__": "builtins"})
    _NumpyArray = _Kind("numpy.ndarray", (), {"stands_for": (np.ndarray,), "__module__": "builtins"})
    _JaxArray = _Kind("jax.Array", (), {"stands_for": (jax.Array,), "__module__": "builtins"})

    class _Shaped:
        """A dtype of jaxtyping's whose annotations ``help`` prints in one short name."""

        def __init__(self, dtype: Any):
            self._dtype = dtype

        def __getitem__(self, of: tuple[type, str]) -> type:
            array, shape = of
            kind = {jax.Array: _JaxArray, np.ndarray: _NumpyArray}.get(array, array)
            shaped = self._dtype[kind, shape]
            shaped.__module__, shaped.__qualname__ = "builtins", f"{self._dtype.__name__}[{kind.__name__}, {shape!r}]"
            return shaped

    Bool, Float, Int = (_Shaped(dtype) for dtype in (jaxtyping.Bool, jaxtyping.Float, jaxtyping.Int))

Lists = list | tuple
"""Nested lists of numbers."""

__all__ = ["AnyArray", "Bool", "Float", "Int", "Lists", "from_lists"]


def from_lists(name: str, value: Any) -> Any:
    """Return a list or tuple of numbers as an array; anything else unchanged, since JAX puts its own objects there."""
    if not isinstance(value, list | tuple):
        return value
    try:
        return jnp.asarray(value, float)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} is neither an array nor nested lists of numbers of equal lengths: {error}") from None
