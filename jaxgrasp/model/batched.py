"""Records of arrays that share leading axes: ``len`` and indexing along the first of these."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import numpy as np

Own = TypeVar("Own", bound="Batched")


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
            raise TypeError(f"this {type(self).__name__} has no leading axes: it is a single one")
        return self.batch_shape

    def __bool__(self) -> bool:
        return True

    def __getitem__(self: Own, index: Any) -> Own:
        """Some of the batch: an index, a slice, an array of indices or a mask, applied to the leading axes."""
        batch = self._batch()
        if isinstance(index, int | np.integer) and not -batch[0] <= index < batch[0]:
            raise IndexError(f"index is {index}: expected one of the {batch[0]} entries of the first axis")
        taken = {}
        for name, shape in self._shapes():
            array = getattr(self, name)
            own = batch + shape[len(shape) - self.last_axes[name] :]
            taken[name] = (array if shape == own else np.broadcast_to(array, own))[index]
        names = list(taken)
        return eqx.tree_at(lambda record: [getattr(record, name) for name in names], self, list(taken.values()))

    def __iter__(self: Own) -> Iterator[Own]:
        return (self[index] for index in range(len(self)))
