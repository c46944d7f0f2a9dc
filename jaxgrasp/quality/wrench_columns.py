"""Wrenches of many grasps as columns of small programs, one for each grasp, which are the last axis."""

from dataclasses import dataclass

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
