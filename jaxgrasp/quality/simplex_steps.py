"""Steps of the revised simplex method on many small programs side by side: minimise costs.x, columns x = right, x >= 0.

A program's columns are its caller's affair, and may be as many as a cone has edges: this holds its basis alone, the
inverse of its columns and how much there is of each. Programs are the last axis, so that each operation runs along it.

Wrenches of many grasps as columns of small programs, one for each grasp, which are the last axis.
"""

from dataclasses import dataclass, fields

import numpy as np

from jaxgrasp.quality.wrench_sets import WrenchSets


@dataclass(frozen=True)
class WrenchColumns:
    """The wrenches of unit normal forces within friction cones, or within pyramids, of ``L`` grasps."""

    discs: np.ndarray
    """``(n, 4, 6, L)``: the centre and the three columns of the span of each contact; zeros for absent ones."""
    corners: np.ndarray | None
    """``(k, 3)``: as of wrench sets."""

    @staticmethod
    def of(bodies: WrenchSets) -> "WrenchColumns":
        return WrenchColumns(np.ascontiguousarray(np.moveaxis(bodies.discs, 0, -1)), bodies.corners)

    def take(self, selection: np.ndarray) -> "WrenchColumns":
        """Return the wrenches of the grasps selected by index or mask."""
        return WrenchColumns(np.take(self.discs, selection, -1), self.corners)

    def principal_axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute squared sizes ``(L, 6)``, ascending, of the discs' matrices and their axes ``(L, 6, 6)``."""
        squares = np.einsum("nkil,nkjl->ijl", self.discs, self.discs)
        return np.linalg.eigh(np.moveaxis(squares, -1, 0))

    def along(self, axes: np.ndarray) -> "WrenchColumns":
        """Express the wrenches in coordinates along the columns of ``axes`` (6, 6, L)."""
        return WrenchColumns(np.einsum("nkil,iml->nkml", self.discs, axes), self.corners)

    def supports(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute each contact's largest power of unit normal force ``(n, L)`` along a direction per grasp ``(6, L)``.

        Also returns the tangential forces ``(n, 3, L)`` that attain it.
        """
        rates = np.einsum("nkjl,jl->nkl", self.discs, directions)
        across = rates[:, 1:]
        if self.corners is not None:
            heights = np.einsum("ck,nkl->cnl", self.corners, across)
            tangential = np.moveaxis(self.corners[np.argmax(heights, 0)], -1, 1)
            return rates[:, 0] + heights.max(0), tangential
        sizes = np.sqrt(np.einsum("nkl,nkl->nl", across, across))
        return rates[:, 0] + sizes, across / np.where(sizes > 0, sizes, 1)[:, None]

    def of_contact(self, contact: np.ndarray, tangential: np.ndarray) -> np.ndarray:
        """Compute the wrench ``(6, L)`` of one contact per grasp, ``contact`` (L,), at tangential force ``(3, L)``."""
        discs = np.take_along_axis(self.discs, contact[None, None, None], 0)[0]
        return discs[0] + np.einsum("kl,kjl->jl", tangential, discs[1:])

    def exerted(self, normal_force: np.ndarray, tangential: np.ndarray) -> np.ndarray:
        """Compute the wrenches ``(6, L)`` of normal forces ``(n, L)`` and tangential forces ``(n, 3, L)``."""
        return np.einsum("nl,njl->jl", normal_force, self.discs[:, 0]) + np.einsum(
            "nkl,nkjl->jl", tangential, self.discs[:, 1:]
        )


FLAT = 1e-11
"""Rate at which a basic column gives way under which it does not."""
MOVES = 1e-7
"""Rate from which on an artificial column that is used up goes, in whichever way it would move."""


@dataclass(frozen=True)
class SimplexBases:
    """Bases of ``L`` programs with ``m`` rows."""

    inverse: np.ndarray
    """``(m, m, L)``."""
    amounts: np.ndarray
    """``(m, L)``: of the basic columns."""
    costs: np.ndarray
    """``(m, L)``."""
    columns: np.ndarray
    """``(m, L)``: whatever number the caller gives its columns, -1 for artificial ones."""

    @staticmethod
    def artificial(right: np.ndarray, cost: float) -> "SimplexBases":
        """Create first bases for right sides ``(m, L)`` from artificial columns, unit vectors or their negatives."""
        signs = np.where(right < 0, -1.0, 1.0)
        inverse = np.eye(len(right))[..., None] * signs
        return SimplexBases(inverse, np.abs(right), np.full(right.shape, cost), np.full(right.shape, -1))

    def take(self, selection: np.ndarray) -> "SimplexBases":
        """Return the bases of the programs selected by index or mask."""
        return SimplexBases(*(np.take(getattr(self, field.name), selection, -1) for field in fields(self)))

    def put(self, selection: np.ndarray, replacements: "SimplexBases") -> None:
        """Overwrite the bases selected by index or mask with others."""
        for field in fields(self):
            getattr(self, field.name)[..., selection] = getattr(replacements, field.name)

    def multipliers(self) -> np.ndarray:
        """Compute the multipliers ``(m, L)``: a column is worth entering if its product with these exceeds its cost."""
        return np.einsum("il,ijl->jl", self.costs, self.inverse)

    def by_contact(self, tangentials: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Sum the columns by contact: normal forces ``(n, L)`` and tangential ones ``(n, 3, L)``.

        Columns below ``count`` are wrenches of the contact of that number, with tangential forces ``tangentials``
        (m, 3, L) per unit of normal force.
        """
        contact_amounts = self.amounts * (self.columns == np.arange(count)[:, None, None])
        return contact_amounts.sum(1), np.einsum("nml,mkl->nkl", contact_amounts, tangentials)

    def left_over(self) -> np.ndarray:
        """Sum the amounts of artificial columns, ``(L,)``."""
        return np.sum(np.where(self.columns < 0, self.amounts, 0), 0)

    def enter(self, columns: np.ndarray, costs: np.ndarray, names: np.ndarray) -> np.ndarray:
        """Bring a column each ``(m, L)`` into the bases.

        Returns:
            ``(L,)``: the position in the basis that it took, -1 where nothing gives way to it.
        """
        programs = np.arange(len(costs))
        rates = np.einsum("ijl,jl->il", self.inverse, columns)
        position, has_pivot = self._leaving(rates, programs)
        pivots = np.where(has_pivot, rates[position, programs], 1)
        rates = np.where(has_pivot, rates, 0)
        row, step = self.inverse[position, :, programs].T / pivots, self.amounts[position, programs] / pivots
        np.subtract(self.inverse, rates[:, None] * row, out=self.inverse)
        np.maximum(self.amounts - rates * step, 0, out=self.amounts)
        position, programs = position[has_pivot], programs[has_pivot]
        self.inverse[position, :, programs] = row[:, has_pivot].T
        self.amounts[position, programs] = step[has_pivot]
        self.costs[position, programs], self.columns[position, programs] = costs[has_pivot], names[has_pivot]
        positions = np.full(len(has_pivot), -1)
        positions[has_pivot] = position
        return positions

    def _leaving(self, rates: np.ndarray, programs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the places ``(L,)`` of the columns that give way first, and the mask of programs that have one."""
        sizes = np.abs(rates)
        spent = (self.columns < 0) & (self.amounts <= FLAT) & (sizes > MOVES)
        decreases = (rates > FLAT) | spent
        ratios = np.where(spent, -1, np.where(decreases, self.amounts / np.where(decreases, rates, 1), np.inf))
        # Among columns that give way at once the largest rate loses the fewest digits.
        tied = ratios <= ratios.min(0) + FLAT
        position = np.argmax(np.where(tied, sizes, -1), 0)
        return position, np.isfinite(ratios[position, programs])
