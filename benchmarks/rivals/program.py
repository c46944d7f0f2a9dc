"""The problem as conic and quadratic solvers want it, brought to order one before they see it.

About the weighted centroid, lengths in weighted radii, forces in units of the load: with f_i = s_i a_i + sqrt(k_i) y_i
in each contact's own axes (normal first), minimise |y|^2 / 2 subject to E y = b and
|y_tangential| <= mu (o + y_normal), o = s / sqrt(k). A contact of weight zero has empty columns and o = 0: it stays at
its squeezing force without being a special case.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Answers
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Problems


class Program(NamedTuple):
    """A batch of programs, and what leads back to forces."""

    balance: np.ndarray
    """E, ``(B, 6, 3n)``."""
    residual_wrench: np.ndarray
    """b, ``(B, 6)``."""
    offsets: np.ndarray
    """o, ``(B, n)``."""
    friction: np.ndarray
    roots: np.ndarray
    """sqrt(k), ``(B, n)``."""
    axes: np.ndarray
    """Normal and two tangents of each contact as rows, ``(B, n, 3, 3)``."""
    squeezing: np.ndarray
    load: np.ndarray
    unit: np.ndarray
    centre: np.ndarray
    length: np.ndarray

    def answers(self, y: np.ndarray, multiplier: np.ndarray | None, solved, infeasible) -> Answers:
        """Convert the program's forces and multiplier to the user's units; values that are not finite are no answer."""
        y = np.asarray(y, float).reshape((*self.friction.shape, 3))
        displacements = np.einsum("bnj,bnjc->bnc", self.roots[..., None] * y, self.axes)
        forces = self.load[:, None, None] * (self.squeezing + displacements)
        fine = np.isfinite(forces).all((1, 2))
        if multiplier is not None:
            twist = np.asarray(multiplier, float) * (self.load / self.unit)[:, None]
            angular = twist[:, 3:] / self.length[:, None]
            multiplier = np.concatenate([twist[:, :3] - np.cross(angular, self.centre), angular], -1)
            fine &= np.isfinite(multiplier).all(-1)
            multiplier = np.where(fine[:, None], multiplier, 0)
        forces = np.where(fine[:, None, None], forces, 0)
        return Answers(forces, multiplier, np.asarray(solved, bool) & fine, np.asarray(infeasible, bool))


class Conic(NamedTuple):
    """Minimise |y|^2 / 2 with A y + slack = bound: slack zero, then nonnegative, then in second-order cones."""

    pattern: sparse.csc_matrix
    """Sparsity of A, the same for the whole batch."""
    values: np.ndarray
    """A's entries by column ``(B, nnz)``."""
    bounds: np.ndarray
    pulls: int
    """Nonnegative rows: one a contact where a friction of zero leaves the cone unable to forbid pulling, else none."""
    contacts: int

    def matrix(self, index: int) -> sparse.csc_matrix:
        return self.filled(self.values[index])

    def filled(self, values: np.ndarray) -> sparse.csc_matrix:
        """Return a matrix of A's sparsity."""
        return sparse.csc_matrix((values, self.pattern.indices, self.pattern.indptr), self.pattern.shape)


def program(problem: Problems, weights: np.ndarray) -> Program:
    """Return the programs of a batch, rounded to float64 once centred."""
    centred = R.centred(problem, weights)
    load = centred.squeeze.sum(-1) + np.sqrt(np.sum(centred.wrench**2, -1))
    load = np.where(load > 0, load, 1)
    unit = centred.weights.sum(-1)
    unit = np.where(unit > 0, unit, 1)
    roots = np.sqrt(centred.weights / unit[:, None])
    squeeze = centred.squeeze / load[:, None]
    axes = _axes(centred.normals)
    columns = np.concatenate([axes, np.cross(centred.arms[:, :, None], axes)], -1) * roots[..., None, None]
    squeezing = squeeze[..., None] * centred.normals
    residual_wrench = centred.wrench / load[:, None] - R.resultant(centred, squeezing)
    offsets = np.where(roots > 0, squeeze / np.where(roots > 0, roots, 1), 0)
    balance = columns.reshape(len(load), -1, 6).transpose(0, 2, 1)
    arrays = (
        balance,
        residual_wrench,
        offsets,
        centred.friction,
        roots,
        axes,
        squeezing,
        load,
        unit,
        centred.centre,
        centred.length,
    )
    return Program(*(np.ascontiguousarray(array, float) for array in arrays))


def conic(programs: Program) -> Conic:
    """Return the programs in the form of Clarabel, SCS and Moreau."""
    size, contacts = programs.friction.shape
    pulls = contacts if (programs.friction == 0).any() else 0
    is_stored = np.ones((contacts, 3, 8), bool)
    is_stored[:, 1:, 6] = False
    is_stored[:, :, 6] &= pulls > 0
    entries = np.full((size, contacts, 3, 8), -1.0)
    entries[..., :6] = programs.balance.transpose(0, 2, 1).reshape(size, contacts, 3, 6)
    entries[:, :, 0, 7] = -programs.friction
    rows = np.broadcast_to(np.arange(8), is_stored.shape).copy()
    rows[..., 6] = 6 + np.arange(contacts)[:, None]
    rows[..., 7] = 6 + pulls + np.arange(3 * contacts).reshape(contacts, 3)
    starts = np.concatenate([[0], np.cumsum(is_stored.sum(-1).ravel())])
    shape = (6 + pulls + 3 * contacts, 3 * contacts)
    pattern = sparse.csc_matrix((np.ones(starts[-1]), rows[is_stored], starts), shape)
    edges = np.zeros((size, contacts, 3))
    edges[..., 0] = programs.friction * programs.offsets
    bounds = np.concatenate([programs.residual_wrench, programs.offsets[:, :pulls], edges.reshape(size, -1)], -1)
    return Conic(pattern, entries[:, is_stored], bounds, pulls, contacts)


def epigraph(contacts: int, pulls: int) -> tuple[np.ndarray, sparse.csc_matrix, dict]:
    """Make the objective linear by an epigraph: variables (y, t), t at least |y|, minimise t.

    Returns the cost, the rows to append to A, whose bounds are zero, and the cones behind the six equalities. |y| has
    the same minimiser as its square; its multiplier, times |y|, is the square's.
    """
    size = 3 * contacts
    cost = np.concatenate([np.zeros(size), [1.0]])
    order = np.concatenate([[size], np.arange(size)])
    rows = sparse.csc_matrix(-sparse.eye(size + 1, format="csr")[order])
    return cost, rows, {"l": pulls, "q": [3] * contacts + [size + 1]}


def facets(programs: Program, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inscribed pyramids C y <= d, ``(B, n (sides + 1), 3n)``; the last row of each contact forbids pulling."""
    size, contacts = programs.friction.shape
    angles = (2 * np.arange(sides) + 1) * np.pi / sides
    slope = programs.friction * np.cos(np.pi / sides)
    rows = np.zeros((size, contacts, sides + 1, contacts, 3))
    contact_indices = np.arange(contacts)
    rows[:, contact_indices, :sides, contact_indices, 0] = -slope.T[..., None]
    rows[:, contact_indices, :sides, contact_indices, 1:] = np.stack([np.cos(angles), np.sin(angles)], -1)
    rows[:, contact_indices, sides, contact_indices, 0] = -1
    limits = np.concatenate(
        [np.repeat((slope * programs.offsets)[..., None], sides, -1), programs.offsets[..., None]], -1
    )
    return rows.reshape(size, -1, 3 * contacts), limits.reshape(size, -1)


def _axes(normals: np.ndarray) -> np.ndarray:
    least = np.eye(3)[np.argmin(np.abs(normals), -1)]
    first = np.cross(normals, least)
    first = first / np.sqrt(np.sum(first**2, -1, keepdims=True))
    return np.stack([normals, first, np.cross(normals, first)], -2)
