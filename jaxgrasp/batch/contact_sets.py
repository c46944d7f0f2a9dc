"""Contact sets of different sizes, with the wrenches they must exert: the NumPy container that files hold."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxgrasp.files.printable import shortened
from jaxgrasp.model.arrays import AnyArray, checked_index
from jaxgrasp.model.faults import (
    UNIT_LENGTH,
    Fault,
    GraspError,
    check_limits,
    limit_faults,
    shape_faults,
    to_middle,
    value_faults,
)
from jaxgrasp.model.grasp import BOUNDS, NORMALS, Grasp, Limits

CONTACT_FIELDS = ("points", "normals", "friction", "squeeze")
OPTIONAL_NUMBERS = ("torsion", *NORMALS)
"""Names of other arrays that have one number for each contact; sets need not have them."""
OPTIONAL_FIELDS = (*OPTIONAL_NUMBERS, "torque_map")


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
    torsion: np.ndarray | None = None
    """``(M,)`` [m]; None where all contacts are hard fingers."""
    normal_min: np.ndarray | None = None
    """``(M,)`` [N]; this and the following as in [`jaxgrasp.Limits`][], None where there is no such limit."""
    normal_max: np.ndarray | None = None
    torque_map: np.ndarray | None = None
    """``(M, c, j)``."""
    torque_max: np.ndarray | None = None
    """``(N, j)``."""
    lines: np.ndarray | None = None
    """``(M,)``: the line of each contact in the text file that it was read from; None where there is none."""

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, chosen: "int | slice | np.ndarray") -> "Grasp | ContactSets":
        """Return a single grasp for an index, or contact sets for a slice, an array of indices or a mask."""
        numbers = np.arange(len(self))[checked_index(chosen, (len(self),))]
        return self.rows(numbers) if np.ndim(numbers) else self.grasp(int(numbers))

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

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Arrays of the contacts that are not None, by field, ``(M, ...)``."""
        fields = {name: getattr(self, name) for name in (*CONTACT_FIELDS, *OPTIONAL_FIELDS)}
        return {name: array for name, array in fields.items() if array is not None}

    @classmethod
    def from_grasp(cls, grasp: Grasp, wrench: np.ndarray, limits: Limits | None = None) -> "ContactSets":
        """Make contact sets of a batch of grasps of equal size; contacts that are not ``present`` are left out.

        Args:
            grasp: contacts ``(N, n)``, or ``(n,)`` for one grasp.
            wrench: ``(N, 6)`` or ``(N, W, 6)``; ``(6,)`` serves every grasp.
            limits: of the same shape as the grasps.
        """
        for fault in shape_faults(grasp):
            raise GraspError(fault)
        if limits is not None:
            check_limits(limits, grasp)
        points = np.asarray(grasp.points)
        if points.ndim > 3:
            raise GraspError(Fault("points", (), f"an array of shape {points.shape}", "a shape (n, 3) or (N, n, 3)"))
        points = points if points.ndim == 3 else points[None]
        count, n, _ = points.shape
        present = (
            np.ones((count, n), bool) if grasp.present is None else np.asarray(grasp.present).reshape(count, n) > 0.5
        )
        fields = {name: getattr(grasp, name) for name in (*CONTACT_FIELDS, "torsion")}
        fields |= {name: getattr(limits, name, None) for name in BOUNDS}
        columns: dict[str, Any] = {name: np.asarray(array) for name, array in fields.items() if array is not None}
        leading, everywhere = np.asarray(grasp.friction).ndim, bool(present.all())
        for name, array in columns.items():
            if name == "torque_max":
                columns[name] = array.reshape(count, -1)
            else:
                by_contact = array.reshape(count * n, *array.shape[leading:])
                # A mask would copy all of it.
                columns[name] = by_contact if everywhere else by_contact[present.ravel()]
        offsets = np.concatenate([[0], np.cumsum(present.sum(1))])
        return cls(**columns, offsets=offsets, wrench=as_wrenches(np.asarray(wrench), count))

    def grasp(self, index: int) -> Grasp:
        """Return a single grasp at its own size, without padding."""
        contacts = slice(self.offsets[index], self.offsets[index + 1])
        torsion = None if self.torsion is None else self.torsion[contacts]
        points, normals, friction, squeeze = (getattr(self, name)[contacts] for name in CONTACT_FIELDS)
        return Grasp(points, normals, friction, squeeze, torsion=torsion)

    def rows(self, chosen: slice | np.ndarray) -> "ContactSets":
        """Return the chosen grasps as contact sets; ``chosen`` is a slice or an array of indices."""
        if isinstance(chosen, slice):
            start, stop, step = chosen.indices(len(self))
            if step != 1:
                return self.rows(np.arange(start, stop, step))
            stop = max(start, stop)
            contacts: slice | np.ndarray = slice(self.offsets[start], self.offsets[stop])
            offsets = self.offsets[start : stop + 1] - self.offsets[start]
        else:
            sizes = self.sizes[chosen]
            offsets = np.concatenate([[0], np.cumsum(sizes)])
            contacts = np.repeat(self.offsets[:-1][chosen] - offsets[:-1], sizes) + np.arange(offsets[-1])
        changed: dict[str, Any] = {name: array[contacts] for name, array in self.columns.items()}
        if self.torque_max is not None:
            changed["torque_max"] = self.torque_max[chosen]
        if self.lines is not None:
            changed["lines"] = self.lines[contacts]
        return replace(
            self,
            **changed,
            offsets=offsets,
            wrench=self.wrench[chosen],
            labels={name: values[chosen] for name, values in self.labels.items()},
        )

    def padded(self, width: int) -> Grasp:
        """Pad all grasps to a batch ``(N, width)``; ``present`` is 0 at the padding, None if there is none."""
        points, normals, friction, squeeze = (self._spread(name, width) for name in CONTACT_FIELDS)
        torsion = None if self.torsion is None else self._spread("torsion", width)
        mask = np.arange(width) < self.sizes[:, None]
        present = None if mask.all() else mask.astype(self.points.dtype)
        return Grasp(points, normals, friction, squeeze, present=present, torsion=torsion)

    def limits(self, width: int) -> Limits | None:
        """Pad the limits of all grasps to a batch of ``padded``'s shape; return None if there are no limits."""
        fields = {name: getattr(self, name) for name in BOUNDS}
        bounds = {name: array for name, array in fields.items() if array is not None}
        if not bounds:
            return None
        padded = {name: array if name == "torque_max" else self._spread(name, width) for name, array in bounds.items()}
        return Limits(**padded)

    def _spread(self, name: str, width: int) -> np.ndarray:
        """Spread a column ``(M, ...)`` to ``(N, width, ...)``, padded with zeros."""
        array, count = getattr(self, name), len(self)
        if np.all(self.sizes == width):
            return array.reshape(count, width, *array.shape[1:])
        wide = np.zeros((count, width, *array.shape[1:]), array.dtype)
        wide[np.arange(width) < self.sizes[:, None]] = array
        return wide

    def towards_middle(self) -> np.ndarray:
        """Compute the vector from each contact to the mean of its grasp's contacts, ``(M, 3)`` [m]."""
        return to_middle(self.points, self.offsets)

    def reach(self) -> np.ndarray:
        """Compute the largest distance of a contact from the middle [m], for each grasp that has contacts."""
        starts = self.offsets[:-1][self.sizes > 0]
        return (
            np.maximum.reduceat(np.linalg.norm(self.towards_middle(), axis=1), starts) if len(starts) else np.zeros(0)
        )

    def astype(self, dtype: np.dtype) -> "ContactSets":
        """Convert all numbers of these sets to another precision."""
        arrays = self.columns | {"wrench": self.wrench}
        if self.torque_max is not None:
            arrays["torque_max"] = self.torque_max
        changed: dict[str, Any] = {name: np.asarray(array, dtype) for name, array in arrays.items()}
        return replace(self, **changed)

    def faults(self, first_grasp: int = 0) -> Iterator[Fault]:
        """Yield every bad entry, by grasp and contact; ``first_grasp`` is the number of the first grasp here.

        Each says which line of a text file it stands in and its grasp's name, where there are any.
        """
        for fault in self._faults():
            grasp, *entry = fault.index
            location = self._location(first_grasp, grasp, entry[0] if entry and fault.field != "wrench" else 0)
            yield replace(fault, index=(first_grasp + grasp, *entry), place=location)

    def _location(self, first_grasp: int, grasp: int, contact: int) -> str:
        name = self.name_of(grasp)
        title = f"grasp {shortened(name)}" if name else ""
        if self.lines is None or not self.sizes[grasp]:
            return title
        return f"line {self.lines[self.offsets[grasp] + contact]}, {title or f'grasp {first_grasp + grasp}'}"

    def name_of(self, grasp: int) -> str:
        """Return the name of a grasp by its index; empty text if it has no name."""
        return str(self.labels["name"][grasp]) if "name" in self.labels else ""

    def _faults(self) -> Iterator[Fault]:
        columns = self.columns
        bounds = {name: columns.pop(name) for name in BOUNDS if name in columns}
        for fault in (*value_faults(**columns), *limit_faults(bounds, np.ones(self.friction.shape, bool))):
            grasp = int(np.searchsorted(self.offsets, fault.index[0], "right")) - 1
            contact = fault.index[0] - int(self.offsets[grasp])
            if fault.expected == UNIT_LENGTH:
                fault = replace(fault, expected=f"{UNIT_LENGTH}; --normalize, or normalize=True, makes it so")
            yield replace(fault, index=(grasp, contact, *fault.index[1:]))
        if self.torque_max is not None:
            yield from limit_faults({"torque_max": self.torque_max}, np.ones(1, bool))
        for index in np.argwhere(~np.isfinite(self.wrench).all(-1)):
            text = np.array2string(self.wrench[tuple(index)], precision=6)
            entry = (int(index[0]), *map(int, index[1:] if self.wrenches > 1 else ()))
            yield Fault("wrench", entry, text, "six finite numbers [N, N.m]")
        for empty in np.flatnonzero(self.sizes == 0):
            yield Fault("offsets", (int(empty),), "a grasp of no contacts", "at least one contact")

    def normalized(self) -> "ContactSets":
        """Return these sets with normals of length 1; those of no length, or of no finite one, stay as they are."""
        length = np.linalg.norm(self.normals.astype(float), axis=1, keepdims=True)
        usable = np.isfinite(length) & (length > 0)
        unit = np.where(usable, self.normals / np.where(usable, length, 1), self.normals)
        return replace(self, normals=unit.astype(self.normals.dtype))


def as_wrenches(wrench: np.ndarray, count: int) -> np.ndarray:
    """Reshape wrenches ``(6,)``, ``(N, 6)`` or ``(N, W, 6)`` to ``(N, W, 6)``."""
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


def as_sets(grasps: ContactSets | Grasp, wrenches: AnyArray | None, limits: Limits | None) -> ContactSets:
    """Make contact sets of public functions' arguments: sets, or a batch of grasps with wrenches and limits."""
    if isinstance(grasps, Grasp):
        if wrenches is None:
            raise ValueError("wrenches is None: expected an array (N, 6) with a batch of grasps")
        return ContactSets.from_grasp(grasps, np.asarray(wrenches), limits)
    if limits is not None:
        raise ValueError("limits is given: expected None with contact sets, which hold their own limits")
    if wrenches is None:
        return grasps
    return replace(grasps, wrench=as_wrenches(np.asarray(wrenches), len(grasps)))
