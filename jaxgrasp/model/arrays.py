"""Arrays of the public surface: their types, and records of arrays that share leading axes.

Names of the types in signatures are short: ``Float[Array, '... n 3']``. Of a record, ``len`` and indexing go along the
first leading axis.
"""

from collections.abc import Iterator
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import equinox as eqx
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

__all__ = ["AnyArray", "Batched", "Bool", "Float", "Int", "Lists", "checked_index", "from_lists"]


def from_lists(name: str, value: Any) -> Any:
    """Return a list or tuple of numbers as an array; anything else unchanged, since JAX puts its own objects there."""
    if not isinstance(value, list | tuple):
        return value
    try:
        return jnp.asarray(value, float)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} is neither an array nor nested lists of numbers of equal lengths: {error}") from None


BatchedT = TypeVar("BatchedT", bound="Batched")


class Batched(eqx.Module):
    """A record whose arrays have the same leading axes, before last axes of their own."""

    last_axes: ClassVar[dict[str, int]]
    """How many last axes each field has that belong to one problem."""

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading axes, against which every field broadcasts."""
        return np.broadcast_shapes(*(shape[: len(shape) - self.last_axes[name]] for name, shape in self._shapes()))

    def _shapes(self) -> list[tuple[str, tuple[int, ...]]]:
        arrays = ((field.name, getattr(self, field.name)) for field in fields(self))
        return [(name, np.shape(array)) for name, array in arrays if array is not None]

    def __len__(self) -> int:
        """Entries along the first leading axis."""
        return self._batch()[0]

    def _batch(self) -> tuple[int, ...]:
        if not self.batch_shape:
            raise TypeError(f"this {type(self).__name__} is a single item, not a batch: it has no leading axes")
        return self.batch_shape

    def __bool__(self) -> bool:
        """Return True, for an empty batch too: a record is not a list."""
        return True

    def __getitem__(self: BatchedT, index: Any) -> BatchedT:
        """Select from the batch by a NumPy index, which counts along the leading axes alone.

        Raises:
            IndexError: for an index beyond the batch, or of more axes than it has. One that is traced cannot be looked
                at, and ends at the last entry, as everywhere in JAX.
            TypeError: where there are no leading axes.
        """
        batch = self._batch()
        checked = checked_index(index, batch)
        taken = {}
        for name, shape in self._shapes():
            array = getattr(self, name)
            wide = batch + shape[len(shape) - self.last_axes[name] :]
            taken[name] = (array if shape == wide else np.broadcast_to(array, wide))[checked]
        names = list(taken)
        return eqx.tree_at(lambda record: [getattr(record, name) for name in names], self, list(taken.values()))

    def __iter__(self: BatchedT) -> Iterator[BatchedT]:
        return (self[index] for index in range(len(self)))


def checked_index(index: Any, batch: tuple[int, ...]) -> tuple:
    """Return an index of the leading axes as a tuple that leaves the last axes alone."""
    parts = tuple(map(_part, index if isinstance(index, tuple) else (index,)))
    if not any(isinstance(part, jax.core.Tracer) for part in parts):
        concrete = tuple(np.asarray(part) if isinstance(part, jax.Array) else part for part in parts)
        try:
            _ = np.broadcast_to(np.False_, batch)[concrete]
        except IndexError as error:
            raise IndexError(f"index is {index!r}: expected an index into a batch of shape {batch} ({error})") from None
    used = sum(_axes(part) for part in parts)
    if used > len(batch):
        raise IndexError(f"index has {used} axes: expected at most {len(batch)}, those of the batch")
    where = next((place for place, part in enumerate(parts) if part is Ellipsis), len(parts))
    return (*parts[:where], *[slice(None)] * (len(batch) - used), *parts[where + 1 :])


def _part(part: Any) -> Any:
    """Return one axis's index; a list becomes an array, an empty one of integers."""
    if part is None or isinstance(part, bool):
        raise IndexError(f"index has a new axis ({part}): expected a part of the batch")
    if not isinstance(part, list):
        return part
    return np.asarray(part) if part else np.zeros(0, int)


def _axes(part: Any) -> int:
    """Count the axes that an index takes; a mask takes as many as it has."""
    if part is Ellipsis:
        return 0
    return part.ndim if getattr(part, "dtype", None) == np.dtype(bool) else 1
