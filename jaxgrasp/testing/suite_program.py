"""Problems of the suite as cone solvers want them: minimise x'Px / 2 + q'x with A x + slack = b, slack in cones.

Unscaled, x are forces in newtons in the user's frame and moments in N.m, and the balance is about the frame's origin.
Scaled, lengths are in weighted radii about the weighted centroid, forces in units of the load, and x the deviations
from the squeezing forces over the roots of their weights, in each contact's own axes: the objective is |x|^2 / 2.
Contacts of weight zero are constants, and a contact without friction has its normal force as its only unknown, so that
every cone has an interior. Computed in long double and rounded once.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.testing.references import Wide, tangents
from jaxgrasp.testing.suite_problem import Frame, SuiteProblem, frame, spin_radius


class Program(NamedTuple):
    """One conic program; rows are ordered: slack zero, then nonnegative, then second-order cones."""

    quadratic: Any
    """P, a sparse matrix by columns."""
    linear: np.ndarray
    """q."""
    matrix: Any
    """A, a sparse matrix by columns."""
    bound: np.ndarray
    """b."""
    n_zero: int
    n_nonnegative: int
    cone_sizes: tuple[int, ...]
    """A cone's first slack is at least the length of its others."""
    constant: float
    """Added to the objective to give the cost in the program's units."""
    cost_unit: float
    """The suite's objective for one unit of the program's."""
    offsets: np.ndarray
    """Forces and moment of each contact at x = 0 ``(n, 4)``."""
    columns: np.ndarray
    """Forces and moments by x ``(n, 4, size)``."""
    coordinates: Frame | None
    """Of the balance; None where it is about the frame's origin in newtons and metres."""

    def objective(self, problem: SuiteProblem) -> float:
        """Return the reference's objective in the program's units, the constant included."""
        return float(problem.optimum / self.cost_unit)

    def cost_root(self) -> tuple[np.ndarray, np.ndarray]:
        """Return F ``(size, size)`` and c ``(size,)`` with |F x + c|^2 = x'Px / 2 + q'x + constant.

        Frictionless contacts of the unscaled program, too, deviate along their only axis alone.
        """
        diagonal = self.quadratic.diagonal()
        return np.diag(np.sqrt(diagonal / 2)), self.linear / np.sqrt(2 * diagonal)

    def forces(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return forces ``(n, 3)`` [N] and moments ``(n,)`` [N.m] of a solution."""
        vectors = self.offsets + self.columns @ np.asarray(x, float)
        return vectors[:, :3], vectors[:, 3]

    def certificate(self, z: np.ndarray) -> np.ndarray:
        """Return the twist about the frame's origin from multipliers z of A x + slack = b that prove infeasibility."""
        d = -np.asarray(z[:6], float)
        if self.coordinates is None:
            return d
        angular = d[3:] / float(self.coordinates.length)
        return np.concatenate([d[:3] - np.cross(angular, np.asarray(self.coordinates.centre, float)), angular])


class _Contacts(NamedTuple):
    """Affine map from x to the contact vectors (force, moment), in long double, and the cost's diagonal."""

    offsets: np.ndarray
    columns: np.ndarray
    owner: np.ndarray
    """Contact of each unknown ``(size,)``."""
    quadratic: np.ndarray
    linear: np.ndarray
    constant: np.longdouble
    cost_unit: np.longdouble


def conic_program(problem: SuiteProblem, *, is_scaled: bool) -> Program:
    """Return the conic program of a problem, scaled or in the user's units."""
    return _program(problem, is_scaled, 0)


def check_sides(sides: int) -> None:
    """Raise ValueError where a pyramid cannot have so many sides."""
    if sides < 3:
        raise ValueError(f"sides is {sides}: expected at least 3")


def pyramid_program(problem: SuiteProblem, *, sides: int = 8, is_scaled: bool) -> Program:
    """Return the quadratic program with inscribed pyramids of ``sides`` sides in place of the friction cones.

    Raises:
        ValueError: for soft fingers, or fewer than 3 sides.
    """
    if problem.torsion is not None:
        raise ValueError(f"{problem.name} has soft fingers: expected hard fingers for pyramids")
    check_sides(sides)
    return _program(problem, is_scaled, sides)


def _program(problem: SuiteProblem, is_scaled: bool, sides: int) -> Program:
    from scipy import sparse

    coordinates = frame(problem)
    contacts = _contacts(problem, coordinates, is_scaled)
    zero = _balance(problem, coordinates, contacts, is_scaled)
    blocks = list(_friction(problem, coordinates, contacts, is_scaled, sides))
    nonnegative = [(rows, bound) for kind, rows, bound in blocks if kind == "linear"]
    nonnegative += list(_torque_limits(problem, coordinates, contacts, is_scaled))
    cones = [(rows, bound) for kind, rows, bound in blocks if kind == "cone"]
    parts: list[Rows] = [zero, *nonnegative, *cones]
    return Program(
        sparse.csc_matrix(np.diag(np.asarray(contacts.quadratic, float))),
        np.asarray(contacts.linear, float),
        sparse.csc_matrix(np.concatenate([np.asarray(rows, float) for rows, _ in parts])),
        np.concatenate([np.asarray(bound, float) for _, bound in parts]),
        len(zero[1]),
        sum(len(bound) for _, bound in nonnegative),
        tuple(len(bound) for _, bound in cones),
        float(contacts.constant),
        float(contacts.cost_unit),
        np.asarray(contacts.offsets, float),
        np.asarray(contacts.columns, float),
        coordinates if is_scaled else None,
    )


def _contacts(problem: SuiteProblem, coordinates: Frame, is_scaled: bool) -> _Contacts:
    n, normals = len(problem.friction), coordinates.normals
    radii = np.asarray(spin_radius(problem), Wide)
    squeeze, weights = np.asarray(problem.squeeze, Wide), np.asarray(problem.weights, Wide)
    unit = coordinates.load if is_scaled else Wide(1)
    total = weights.sum()
    offsets = np.zeros((n, 4), Wide)
    bases, quadratic, linear, owner, constant = [], [], [], [], Wide(0)
    for i in range(n):
        held = squeeze[i] * normals[i]
        if weights[i] == 0:
            offsets[i, :3] = held
            continue
        if problem.friction[i] == 0:
            axes = normals[i : i + 1]
        elif is_scaled:
            axes = np.stack([normals[i], *_tangents(normals[i])])
        else:
            axes = np.eye(3, dtype=Wide)
        basis = np.zeros((4, len(axes) + (radii[i] > 0)), Wide)
        basis[:3, : len(axes)] = axes.T
        sizes = np.ones(basis.shape[1], Wide)
        if radii[i] > 0:
            # Scaled, the unknown is the spin component, moment over radius, as for the deviations of forces.
            basis[3, -1] = radii[i] if is_scaled else 1
            sizes[-1] = 1 if is_scaled else radii[i]
        if is_scaled:
            offsets[i, :3] = held
            basis = basis * (unit * np.sqrt(weights[i] / total))
            quadratic.append(np.ones(basis.shape[1], Wide))
            linear.append(np.zeros(basis.shape[1], Wide))
        else:
            quadratic.append(1 / (weights[i] * sizes**2))
            linear.append(-(held @ basis[:3]) / weights[i])
            constant += squeeze[i] ** 2 / (2 * weights[i])
        bases.append(basis)
        owner += [i] * basis.shape[1]
    columns = np.zeros((n, 4, len(owner)), Wide)
    place = 0
    for basis in bases:
        columns[owner[place], :, place : place + basis.shape[1]] = basis
        place += basis.shape[1]
    cost_unit = unit**2 / total if is_scaled else Wide(1)
    none = [np.zeros(0, Wide)]
    return _Contacts(
        offsets, columns, np.array(owner, int), np.concatenate(quadratic or none), np.concatenate(linear or none),
        constant, cost_unit,
    )  # fmt: skip


Rows = tuple[np.ndarray, np.ndarray]
"""Rows of A and their bounds."""


def _balance(problem: SuiteProblem, coordinates: Frame, contacts: _Contacts, is_scaled: bool) -> Rows:
    """Return the six equations of the wrench."""
    arms = coordinates.arms if is_scaled else np.asarray(problem.points, Wide)
    length = coordinates.length if is_scaled else Wide(1)
    unit = coordinates.load if is_scaled else Wide(1)
    wrench = coordinates.wrench if is_scaled else np.asarray(problem.wrench, Wide)

    def exerted(vectors: np.ndarray) -> np.ndarray:
        """Sum the wrenches of contact vectors ``(n, 4)``."""
        moments = vectors[:, 3:] / length * coordinates.normals
        return np.concatenate([vectors[:, :3].sum(0), (np.cross(arms, vectors[:, :3]) + moments).sum(0)])

    rows = [exerted(contacts.columns[:, :, c]) for c in range(contacts.columns.shape[2])]
    matrix = np.stack(rows, 1) if rows else np.zeros((6, 0), Wide)
    return matrix / unit, (wrench - exerted(contacts.offsets)) / unit


def _friction(
    problem: SuiteProblem, coordinates: Frame, contacts: _Contacts, is_scaled: bool, sides: int
) -> Iterable[tuple[str, np.ndarray, np.ndarray]]:
    """Yield the rows of each contact's cone, or of its pyramid where there are ``sides``."""
    unit = coordinates.load if is_scaled else Wide(1)
    radii = np.asarray(spin_radius(problem), Wide)
    for i, mu in enumerate(np.asarray(problem.friction, Wide)):
        if problem.weights[i] == 0:
            continue
        normal = np.append(coordinates.normals[i], Wide(0))
        shrink = np.sqrt(problem.weights[i] / np.asarray(problem.weights, Wide).sum()) if is_scaled else Wide(1)
        scale = unit * shrink
        if mu == 0:
            yield "linear", *_slack(normal[None] / scale, contacts, i)
            continue
        across = [np.append(t, Wide(0)) for t in _tangents(coordinates.normals[i])]
        if sides:
            angles = (2 * np.arange(sides) + 1) * np.pi / sides
            slope = mu * np.cos(np.pi / sides)
            edges = [slope * normal - np.cos(x) * across[0] - np.sin(x) * across[1] for x in angles]
            yield "linear", *_slack(np.stack([*edges, normal]) / scale, contacts, i)
            continue
        if radii[i] > 0:
            across.append(np.append(np.zeros(3, Wide), 1 / radii[i]))
        size = np.maximum(mu, 1) if is_scaled else Wide(1)
        yield "cone", *_slack(np.stack([mu * normal, *across]) / (size * scale), contacts, i)


def _slack(rows: np.ndarray, contacts: _Contacts, i: int) -> Rows:
    """Return the rows and bounds by which ``rows`` of contact i's vector are slacks."""
    return -rows @ contacts.columns[i], rows @ contacts.offsets[i]


def _torque_limits(problem: SuiteProblem, coordinates: Frame, contacts: _Contacts, is_scaled: bool) -> Iterable[Rows]:
    if problem.torque_map is None or problem.torque_max is None:
        return
    torque_map = np.asarray(problem.torque_map, Wide)
    rows = np.einsum("ncj,ncx->jx", torque_map, contacts.columns[:, :3])
    start = np.einsum("ncj,nc->j", torque_map, contacts.offsets[:, :3])
    most = np.asarray(problem.torque_max, Wide)
    if is_scaled:
        size = np.sqrt(np.sum(rows**2, -1))
        size = np.where(size > 0, size, 1)
        rows, start, most = rows / size[:, None], start / size, most / size
    yield np.concatenate([rows, -rows]), np.concatenate([most - start, most + start])


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors across a normal, in long double."""
    first, _ = tangents(np.asarray(normal, float))
    first = np.asarray(first, Wide)
    first = first - (first @ normal) * normal
    first /= np.sqrt(first @ first)
    return first, np.cross(normal, first)
