"""Names of numbers in nested parameters or outputs, and selection by name.

An array in a tree is named by its path, such as ``held.friction``, or by as much of the path's end as is unique,
``friction``; its entries by their index, ``friction[2]``, or by a label in its place, ``friction[index]``.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray

Labels = Mapping[str, Sequence[str]]
"""Labels of an array's entries along its first axis, by the array's name."""

UNITS = {
    "angles": "rad",
    "azimuths": "rad",
    "center_of_mass": "m",
    "depths": "m",
    "forces": "N",
    "gravity": "m/s^2",
    "heights": "m",
    "inertia": "kg.m^2",
    "least_squeeze": "N",
    "length": "m",
    "friction_margin": "rad",
    "stability_margin": "rad",
    "mass": "kg",
    "origin": "m",
    "points": "m",
    "radius": "m",
    "slip_angle": "rad",
    "speed": "rad/s",
    "squeeze": "N",
    "stiffness": "N/m",
    "torques": "N.m",
}
"""Units of the quantities that this package names; other quantities have none, or a unit that only the caller knows."""


@dataclass(frozen=True)
class Entry:
    """A number in a tree."""

    leaf: int
    """Index of its array among the tree's leaves."""
    index: tuple[int, ...]
    path: str
    """Path of its array in the tree."""
    name: str
    """Shortest unique end of the path."""
    place: str
    """Position in its array: indices or labels in brackets; empty for a plain number."""

    @property
    def label(self) -> str:
        """Return the unique name."""
        return self.name + self.place

    @property
    def unit(self) -> str:
        """Return the unit, empty if this package does not know it."""
        return UNITS.get(self.name.rsplit(".", 1)[-1], "")

    def is_called(self, name: str) -> bool:
        """Return whether a name applies to the entry: its own, its array's, or that of a node around its array."""
        return name in (self.label, self.path + self.place) or _ends_with(self.path, name) or name in _around(self.path)


def entries_of(tree: Any, labels: Labels | None = None) -> tuple[Entry, ...]:
    """List every number of a tree's floating-point arrays, or of their shapes, in order.

    Raises:
        ValueError: for too many or too few labels of an array, and for two numbers with the same name.
    """
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    paths = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves]
    entries = []
    for k, ((_, leaf), path) in enumerate(zip(leaves, paths, strict=True)):
        if not is_number(leaf):
            continue
        name = _shortest(path, paths)
        first = _labels_of(name, path, leaf.shape, labels or {})
        for index in np.ndindex(leaf.shape):
            parts = [first[index[0]], *map(str, index[1:])] if index else []
            entries.append(Entry(k, index, path, name, f"[{', '.join(parts)}]" if index else ""))
    labels_so_far: set[str] = set()
    for entry in entries:
        if entry.label in labels_so_far:
            raise ValueError(f"two entries are called {entry.label!r}: expected names and labels that differ")
        labels_so_far.add(entry.label)
    return tuple(entries)


def select_entries(entries: Sequence[Entry], names: Iterable[str] | None) -> tuple[Entry, ...]:
    """Select the entries with these names, without duplicates; all of them for ``None``.

    Raises:
        ValueError: for an unknown name, with the most similar one.
    """
    if names is None:
        return tuple(entries)
    if isinstance(names, str):
        raise ValueError(f"names of parameters are {names!r}: expected a list of names")
    selected: dict[Entry, None] = {}
    for name in names:
        # A full path takes precedence over other paths that end with it.
        exact = [entry for entry in entries if name in (entry.path, entry.path + entry.place)]
        matches = exact or [entry for entry in entries if entry.is_called(name)]
        if not matches:
            raise ValueError(f"name {name!r} is unknown{_nearest(name, entries)}")
        selected.update(dict.fromkeys(matches))
    if not selected:
        raise ValueError("no names of parameters are given: expected at least one")
    return tuple(selected)


def check_labels(labels: Labels | None, entries: Sequence[Entry]) -> None:
    """Raise ValueError for labels of an unknown array."""
    for name in labels or {}:
        if not any(_ends_with(entry.path, name) for entry in entries):
            raise ValueError(
                f"labels are given for {name!r}, which is not a parameter or output{_nearest(name, entries)}"
            )


def is_number(leaf: Any) -> bool:
    """Return whether a leaf is a floating-point array, whose numbers can be varied."""
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)


def check_finite(tree: Any, entries: Sequence[Entry]) -> None:
    """Raise ValueError where a parameter is NaN or infinite."""
    leaves = jax.tree.leaves(tree)
    for leaf, members in _by_leaf(entries):
        values = np.asarray(leaves[leaf])
        for entry in members if not np.isfinite(values).all() else ():
            if not np.isfinite(values[entry.index]):
                raise ValueError(f"{entry.label} is {values[entry.index]}: expected a finite number")


def row_of(tree: Any, axes: int = 0) -> Array:
    """Concatenate every number of a tree into one row, or into a row for each index of leading axes."""
    numbers = [leaf for leaf in jax.tree.leaves(tree) if is_number(leaf)]
    return jnp.concatenate([leaf.reshape(*leaf.shape[:axes], -1) for leaf in numbers], -1)


def as_arrays(tree: Any) -> Any:
    """Convert plain numbers of a tree into arrays, so that other values need no other program."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float) if _is_plain(leaf) else leaf, tree)


def _is_plain(leaf: Any) -> bool:
    return isinstance(leaf, int | float) and not isinstance(leaf, bool)


class FixedParts(NamedTuple):
    """What of a tree is no array: a program is compiled for it."""

    structure: Any
    leaves: tuple[Any, ...]
    """None in place of arrays."""

    def tree(self, arrays: Sequence[Array]) -> Any:
        """Build the tree with these arrays."""
        remaining = iter(arrays)
        return jax.tree.unflatten(self.structure, [next(remaining) if leaf is None else leaf for leaf in self.leaves])


def split_arrays(tree: Any) -> tuple[list[AnyArray], FixedParts]:
    """Split a tree into its arrays and the rest."""
    leaves, structure = jax.tree.flatten(tree)
    are_arrays = [isinstance(leaf, Array | np.ndarray | np.generic) for leaf in leaves]
    rest = tuple(None if is_array else leaf for leaf, is_array in zip(leaves, are_arrays, strict=True))
    return [leaf for leaf, is_array in zip(leaves, are_arrays, strict=True) if is_array], FixedParts(structure, rest)


def values_at(tree: Any, entries: Sequence[Entry], numpy: Any = jnp) -> Any:
    """Return the values of entries in one row: an array of JAX's, or of NumPy's."""
    leaves = jax.tree.leaves(tree)
    rows = [numpy.asarray(leaves[leaf])[_indices(members)].ravel() for leaf, members in _by_leaf(entries)]
    return numpy.concatenate(rows)


def with_values(tree: Any, entries: Sequence[Entry], values: Array) -> Any:
    """Return the tree with other values of these entries."""
    leaves, structure = jax.tree.flatten(tree)
    start = 0
    for leaf, members in _by_leaf(entries):
        array = jnp.asarray(leaves[leaf])
        new = values[start : start + len(members)].astype(array.dtype)
        leaves[leaf] = new.reshape(array.shape) if _is_whole(members, array) else array.at[_indices(members)].set(new)
        start += len(members)
    return jax.tree.unflatten(structure, leaves)


def _by_leaf(entries: Sequence[Entry]) -> list[tuple[int, list[Entry]]]:
    """Group consecutive entries of one array."""
    return [(leaf, list(members)) for leaf, members in groupby(entries, lambda entry: entry.leaf)]


def _indices(entries: Sequence[Entry]) -> tuple[np.ndarray, ...]:
    return tuple(np.array([entry.index for entry in entries]).T.reshape(-1, len(entries)))


def _is_whole(entries: Sequence[Entry], array: Array) -> bool:
    return [entry.index for entry in entries] == list(np.ndindex(array.shape))


def _labels_of(name: str, path: str, shape: tuple[int, ...], labels: Labels) -> Sequence[str]:
    """Return the labels of the entries along an array's first axis; their indices without labels."""
    if not shape:
        return ()
    own_labels = next((labels[key] for key in labels if _ends_with(path, key)), None)
    if own_labels is None:
        return [str(i) for i in range(shape[0])]
    if not all(isinstance(label, str) for label in own_labels):
        raise ValueError(f"labels of {name} are {own_labels!r}: expected strings")
    if len(own_labels) != shape[0]:
        raise ValueError(
            f"{name} has {shape[0]} entries on its first axis: expected as many labels, not {len(own_labels)}"
        )
    return own_labels


def _shortest(path: str, paths: Sequence[str]) -> str:
    parts = path.split(".")
    ends = (".".join(parts[-k:]) for k in range(1, len(parts)))
    return next((end for end in ends if sum(_ends_with(candidate, end) for candidate in paths) == 1), path)


def _ends_with(path: str, end: str) -> bool:
    return path == end or path.endswith("." + end)


def _around(path: str) -> list[str]:
    """Return the paths of the nodes around an array, from the outside."""
    parts = path.split(".")
    return [".".join(parts[:k]) for k in range(1, len(parts))]


def _nearest(name: str, entries: Sequence[Entry]) -> str:
    names = list(dict.fromkeys(entry.name for entry in entries))
    labels = [entry.label for entry in entries] if "[" in name else []
    similar = difflib.get_close_matches(name, names + labels, 1, 0.5)
    return f": did you mean {similar[0]!r}?" if similar else f": expected one or more of {', '.join(names)}"
