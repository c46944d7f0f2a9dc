"""Numbers by their names: the entries of nested parameters or outputs, and those chosen from them.

An array in a tree is called by its path there, such as ``held.friction``, or by as much of the path's end as no other
shares, ``friction``; its entries by their place, ``friction[2]``, or by a label in its stead, ``friction[index]``.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

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
"""Units of the numbers that this package names; what is not here has none, or its user knows it."""


@dataclass(frozen=True)
class Entry:
    """One number of a tree."""

    leaf: int
    """Which of the tree's leaves it is in."""
    index: tuple[int, ...]
    path: str
    """Path of its array in the tree."""
    name: str
    """As much of the path's end as no other array shares."""
    place: str
    """Place in its array: indices or labels in brackets; empty for a plain number."""

    @property
    def label(self) -> str:
        """What it is called."""
        return self.name + self.place

    @property
    def unit(self) -> str:
        """Its unit, where this package knows it."""
        return UNITS.get(self.name.rsplit(".", 1)[-1], "")

    def is_called(self, name: str) -> bool:
        """Whether a name means it: its own, its array's, or that of something around its array."""
        return name in (self.label, self.path + self.place) or _ends_with(self.path, name) or name in _around(self.path)


def entries_of(tree: Any, labels: Labels | None = None) -> tuple[Entry, ...]:
    """Every number of a tree's floating-point arrays, or of their shapes, in order.

    Raises:
        ValueError: for too many or too few labels of an array, and for two numbers of one name.
    """
    found = jax.tree_util.tree_flatten_with_path(tree)[0]
    paths = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in found]
    entries = []
    for k, ((_, leaf), path) in enumerate(zip(found, paths, strict=True)):
        if not is_number(leaf):
            continue
        name = _shortest(path, paths)
        first = _labels_of(name, path, leaf.shape, labels or {})
        for index in np.ndindex(leaf.shape):
            place = [first[index[0]], *map(str, index[1:])] if index else []
            entries.append(Entry(k, index, path, name, f"[{', '.join(place)}]" if index else ""))
    known: set[str] = set()
    for entry in entries:
        if entry.label in known:
            raise ValueError(f"two numbers are called {entry.label!r}: expected names and labels that differ")
        known.add(entry.label)
    return tuple(entries)


def chosen(entries: Sequence[Entry], names: Iterable[str] | None) -> tuple[Entry, ...]:
    """The entries that are called by these names, each once; all of them for ``None``.

    Raises:
        ValueError: for a name that nothing is called by, with the one most like it.
    """
    if names is None:
        return tuple(entries)
    if isinstance(names, str):
        raise ValueError(f"names of parameters are {names!r}: expected a list of names")
    found: dict[Entry, None] = {}
    for name in names:
        # A whole path means what is there, and not what ends alike elsewhere.
        exact = [entry for entry in entries if name in (entry.path, entry.path + entry.place)]
        these = exact or [entry for entry in entries if entry.is_called(name)]
        if not these:
            raise ValueError(f"there is no {name!r}{_nearest(name, entries)}")
        found.update(dict.fromkeys(these))
    if not found:
        raise ValueError("no parameters are asked for: expected at least one name")
    return tuple(found)


def check_labels(labels: Labels | None, entries: Sequence[Entry]) -> None:
    """Raise ValueError where an array that labels are given for is not there."""
    for name in labels or {}:
        if not any(_ends_with(entry.path, name) for entry in entries):
            raise ValueError(f"labels are given for {name!r}, which there is not{_nearest(name, entries)}")


def is_number(leaf: Any) -> bool:
    """Whether a leaf is made of numbers that can be varied, which floating-point arrays are."""
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)


def check_finite(tree: Any, entries: Sequence[Entry]) -> None:
    """Raise ValueError where a parameter is NaN or infinite."""
    leaves = jax.tree.leaves(tree)
    for leaf, these in _by_leaf(entries):
        values = np.asarray(leaves[leaf])
        for entry in these if not np.isfinite(values).all() else ():
            if not np.isfinite(values[entry.index]):
                raise ValueError(f"{entry.label} is {values[entry.index]}: expected a finite number")


def row_of(tree: Any, axes: int = 0) -> Array:
    """Every number of a tree in one row, or, for a number of leading axes, in a row for each."""
    numbers = [leaf for leaf in jax.tree.leaves(tree) if is_number(leaf)]
    return jnp.concatenate([leaf.reshape(*leaf.shape[:axes], -1) for leaf in numbers], -1)


def as_arrays(tree: Any) -> Any:
    """The tree with plain numbers as arrays, so that other numbers are no other program."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float) if _is_plain(leaf) else leaf, tree)


def _is_plain(leaf: Any) -> bool:
    return isinstance(leaf, int | float) and not isinstance(leaf, bool)


def values_at(tree: Any, entries: Sequence[Entry], numpy: Any = jnp) -> Any:
    """The entries of a tree, in one row: an array of JAX's, or of NumPy's."""
    leaves = jax.tree.leaves(tree)
    rows = [numpy.asarray(leaves[leaf])[_indices(these)].ravel() for leaf, these in _by_leaf(entries)]
    return numpy.concatenate(rows)


def with_values(tree: Any, entries: Sequence[Entry], values: Array) -> Any:
    """The tree with other values of these entries."""
    leaves, structure = jax.tree.flatten(tree)
    start = 0
    for leaf, these in _by_leaf(entries):
        array = jnp.asarray(leaves[leaf])
        new = values[start : start + len(these)].astype(array.dtype)
        leaves[leaf] = new.reshape(array.shape) if _is_whole(these, array) else array.at[_indices(these)].set(new)
        start += len(these)
    return jax.tree.unflatten(structure, leaves)


def _by_leaf(entries: Sequence[Entry]) -> list[tuple[int, list[Entry]]]:
    """Runs of entries of one array."""
    return [(leaf, list(these)) for leaf, these in groupby(entries, lambda entry: entry.leaf)]


def _indices(entries: Sequence[Entry]) -> tuple[np.ndarray, ...]:
    return tuple(np.array([entry.index for entry in entries]).T.reshape(-1, len(entries)))


def _is_whole(entries: Sequence[Entry], array: Array) -> bool:
    return [entry.index for entry in entries] == list(np.ndindex(array.shape))


def _labels_of(name: str, path: str, shape: tuple[int, ...], labels: Labels) -> Sequence[str]:
    """Labels of the entries along an array's first axis: their numbers, where they have no other."""
    if not shape:
        return ()
    given = next((labels[key] for key in labels if _ends_with(path, key)), None)
    if given is None:
        return [str(i) for i in range(shape[0])]
    if not all(isinstance(label, str) for label in given):
        raise ValueError(f"labels of {name} are {given!r}: expected texts")
    if len(given) != shape[0]:
        raise ValueError(f"{name} has {shape[0]} entries on its first axis: expected as many labels, not {len(given)}")
    return given


def _shortest(path: str, paths: Sequence[str]) -> str:
    parts = path.split(".")
    ends = (".".join(parts[-k:]) for k in range(1, len(parts)))
    return next((end for end in ends if sum(_ends_with(other, end) for other in paths) == 1), path)


def _ends_with(path: str, end: str) -> bool:
    return path == end or path.endswith("." + end)


def _around(path: str) -> list[str]:
    """What an array is in, from the outside."""
    parts = path.split(".")
    return [".".join(parts[:k]) for k in range(1, len(parts))]


def _nearest(name: str, entries: Sequence[Entry]) -> str:
    known = list(dict.fromkeys(entry.name for entry in entries))
    places = [entry.label for entry in entries] if "[" in name else []
    like = difflib.get_close_matches(name, known + places, 1, 0.5)
    return f": did you mean {like[0]!r}?" if like else f": expected some of {', '.join(known)}"
