"""Contact sets of different sizes, with the wrenches they must exert: the NumPy container that files hold."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import Fault, GraspError, shape_faults, value_faults
from jaxgrasp.model.grasp import Grasp

CONTACT_FIELDS = ("points", "normals", "friction", "squeeze")


@dataclass(frozen=True)
class ContactSets:
    """N grasps of M contacts in all, and W wrenches for each grasp."""

    points: np.ndarray
    """``(M, 3)`` [m]."""
    normals: np.ndarray
    """``(M, 3)``, unit, into the object."""
    friction: np.ndarray
    """``(M,)``."""
    squeeze: np.ndarray
    """``(M,)`` [N]."""
    offsets: np.ndarray
    """``(N + 1,)``: grasp i owns contacts ``offsets[i]:offsets[i + 1]``."""
    wrench: np.ndarray
    """``(N, W, 6)`` [N, N.m]."""
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Optional text of each grasp, ``(N,)``: name, source, object, hand."""

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def sizes(self) -> np.ndarray:
        """Contacts of each grasp, ``(N,)``."""
        return np.diff(self.offsets)

    @property
    def wrenches(self) -> int:
        """Wrenches of each grasp, W."""
        return self.wrench.shape[1]

    @property
    def largest(self) -> int:
        return int(self.sizes.max(initial=0))

    @classmethod
    def from_grasp(cls, grasp: Grasp, wrench: np.ndarray) -> "ContactSets":
        """A batch of grasps of one size; contacts that are not ``present`` are left out.

        Args:
            grasp: contacts ``(N, n)``, or ``(n,)`` for one grasp.
            wrench: ``(N, 6)`` or ``(N, W, 6)``; ``(6,)`` serves every grasp.
        """
        for fault in shape_faults(grasp):
            raise GraspError(fault)
        if grasp.torsion is not None:
            raise GraspError(Fault("torsion", (), "given", "None: contact sets hold hard fingers only"))
        points = np.asarray(grasp.points)
        if points.ndim > 3:
            raise GraspError(Fault("points", (), f"an array of shape {points.shape}", "a shape (n, 3) or (N, n, 3)"))
        points = points if points.ndim == 3 else points[None]
        count, n, _ = points.shape
        present = (
            np.ones((count, n), bool) if grasp.present is None else np.asarray(grasp.present).reshape(count, n) > 0.5
        )
        columns = {"points": points[present]}
        for name in CONTACT_FIELDS[1:]:
            array = np.asarray(getattr(grasp, name))
            columns[name] = array.reshape(count, n, *points.shape[2:] if name == "normals" else ())[present]
        offsets = np.concatenate([[0], np.cumsum(present.sum(1))])
        points, normals, friction, squeeze = (columns[name] for name in CONTACT_FIELDS)
        return cls(points, normals, friction, squeeze, offsets, as_wrenches(np.asarray(wrench), count))

    def grasp(self, index: int) -> Grasp:
        """One grasp, of the size that it has."""
        own = slice(self.offsets[index], self.offsets[index + 1])
        return Grasp(*(getattr(self, name)[own] for name in CONTACT_FIELDS))

    def rows(self, chosen: slice | np.ndarray) -> "ContactSets":
        """Some of the grasps: a slice, or an array of indices."""
        if isinstance(chosen, slice):
            start, stop, step = chosen.indices(len(self))
            if step != 1:
                return self.rows(np.arange(start, stop, step))
            stop = max(start, stop)
            own: slice | np.ndarray = slice(self.offsets[start], self.offsets[stop])
            offsets = self.offsets[start : stop + 1] - self.offsets[start]
        else:
            sizes = self.sizes[chosen]
            offsets = np.concatenate([[0], np.cumsum(sizes)])
            own = np.repeat(self.offsets[:-1][chosen] - offsets[:-1], sizes) + np.arange(offsets[-1])
        return replace(
            self,
            **{name: getattr(self, name)[own] for name in CONTACT_FIELDS},
            offsets=offsets,
            wrench=self.wrench[chosen],
            labels={name: values[chosen] for name, values in self.labels.items()},
        )

    def padded(self, width: int) -> Grasp:
        """All grasps as one batch ``(N, width)``; ``present`` marks the padding, if there is any."""
        count = len(self)
        if np.all(self.sizes == width):
            shaped = {name: getattr(self, name) for name in CONTACT_FIELDS}
            points, normals, friction, squeeze = (a.reshape(count, width, *a.shape[1:]) for a in shaped.values())
            return Grasp(points, normals, friction, squeeze)
        there = np.arange(width) < self.sizes[:, None]

        def spread(array: np.ndarray) -> np.ndarray:
            wide = np.zeros((count, width, *array.shape[1:]), array.dtype)
            wide[there] = array
            return wide

        points, normals, friction, squeeze = (spread(getattr(self, name)) for name in CONTACT_FIELDS)
        return Grasp(points, normals, friction, squeeze, present=there.astype(self.points.dtype))

    def towards_middle(self) -> np.ndarray:
        """From each contact to the mean of its grasp's contacts, ``(M, 3)`` [m]."""
        held = np.flatnonzero(self.sizes)
        if not len(held):
            return np.zeros((0, 3))
        sizes = self.sizes[held]
        middle = np.add.reduceat(self.points, self.offsets[:-1][held], axis=0) / sizes[:, None]
        return np.repeat(middle, sizes, axis=0) - self.points

    def reach(self) -> np.ndarray:
        """Largest distance of a contact from the middle, of each grasp that has any [m]."""
        starts = self.offsets[:-1][self.sizes > 0]
        return (
            np.maximum.reduceat(np.linalg.norm(self.towards_middle(), axis=1), starts) if len(starts) else np.zeros(0)
        )

    def astype(self, dtype: np.dtype) -> "ContactSets":
        """The same sets in another precision."""
        names = (*CONTACT_FIELDS, "wrench")
        changed: dict[str, Any] = {name: np.asarray(getattr(self, name), dtype) for name in names}
        return replace(self, **changed)

    def faults(self, first_grasp: int = 0) -> Iterator[Fault]:
        """Every bad entry, by grasp and contact; ``first_grasp`` is the number of the first grasp here."""
        for fault in value_faults(*(getattr(self, name) for name in CONTACT_FIELDS)):
            grasp = int(np.searchsorted(self.offsets, fault.index[0], "right")) - 1
            contact = fault.index[0] - int(self.offsets[grasp])
            yield replace(fault, index=(first_grasp + grasp, contact))
        for index in np.argwhere(~np.isfinite(self.wrench).all(-1)):
            shown = np.array2string(self.wrench[tuple(index)], precision=6)
            place = (first_grasp + int(index[0]), *map(int, index[1:] if self.wrenches > 1 else ()))
            yield Fault("wrench", place, shown, "six finite numbers [N, N.m]")
        for empty in np.flatnonzero(self.sizes == 0):
            yield Fault("offsets", (first_grasp + int(empty),), "a grasp of no contacts", "at least one contact")


def as_wrenches(wrench: np.ndarray, count: int) -> np.ndarray:
    """``(N, W, 6)`` from any of the shapes in which wrenches are given."""
    if wrench.shape == (6,):
        wrench = np.broadcast_to(wrench, (count, 6))
    if wrench.ndim == 2:
        wrench = wrench[:, None]
    if wrench.ndim != 3 or wrench.shape[0] != count or wrench.shape[2] != 6 or wrench.shape[1] == 0:
        shape = wrench[:, 0].shape if wrench.ndim == 3 and wrench.shape[1] == 1 else wrench.shape
        raise GraspError(
            Fault(
                "wrench",
                (),
                f"an array of shape {shape}",
                f"a shape ({count}, 6) or ({count}, W, 6) that fits the grasps",
            )
        )
    return wrench


def as_sets(grasps: ContactSets | Grasp, wrenches: AnyArray | None) -> ContactSets:
    """Contact sets out of what the public functions take."""
    if isinstance(grasps, Grasp):
        if wrenches is None:
            raise ValueError("wrenches is None: expected an array (N, 6) with a batch of grasps")
        return ContactSets.from_grasp(grasps, np.asarray(wrenches))
    if wrenches is None:
        return grasps
    return replace(grasps, wrench=as_wrenches(np.asarray(wrenches), len(grasps)))
