"""Friction pyramids and limits as inequalities, rows . forces <= bounds, each row of unit length.

A slack is thus a distance in the space of contact forces [N], for every type of row.
"""

from typing import Literal

import numpy as np

from jaxgrasp.literature.scaled_problems import HostProblem

Pyramid = Literal["inscribed", "circumscribed"]
"""Edges on the cone, so that friction allows all forces; or facets on the cone, which contain it."""


def check_pyramid(sides: int, pyramid: Pyramid) -> None:
    """Raise ValueError for an invalid number of sides or type of pyramid."""
    if sides < 3:
        raise ValueError(f"sides is {sides}: expected 3 or more")
    if pyramid not in ("inscribed", "circumscribed"):
        raise ValueError(f"pyramid is {pyramid!r}: expected 'inscribed' or 'circumscribed'")


def constraint_rows(problem: HostProblem, sides: int, pyramid: Pyramid) -> tuple[np.ndarray, np.ndarray]:
    """Collect all inequalities: facets, then normal forces from below and above, then torques both ways."""
    parts = (facet_rows(problem, sides, pyramid), normal_rows(problem), torque_rows(problem))
    rows, bounds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rows, bounds


def facet_rows(problem: HostProblem, sides: int, pyramid: Pyramid) -> tuple[np.ndarray, np.ndarray]:
    """Build the facets ``(m sides, 3m)``; the first edge leans towards the first tangent.

    The directions of the edges depend on the frame, and jump as a normal turns.
    """
    angles = (2 * np.arange(sides) + 1) * np.pi / sides
    around = np.stack([np.cos(angles), np.sin(angles)], -1)
    slope = problem.friction * (np.cos(np.pi / sides) if pyramid == "inscribed" else 1.0)
    outward = np.einsum("kt,mtc->mkc", around, problem.tangents)
    rows = (outward - slope[:, None, None] * problem.normals[:, None]) / np.sqrt(1 + slope**2)[:, None, None]
    return _apart(rows), np.zeros(rows.shape[0] * sides)


def normal_rows(problem: HostProblem) -> tuple[np.ndarray, np.ndarray]:
    """Build the bounds of normal forces: from below by the preload, or zero; from above where one is given."""
    normals = _apart(problem.normals[:, None])
    bounded = np.isfinite(problem.normal_max)
    rows = np.concatenate([-normals, normals[bounded]])
    return rows, np.concatenate([-problem.normal_min, problem.normal_max[bounded]])


def torque_rows(problem: HostProblem) -> tuple[np.ndarray, np.ndarray]:
    """Build the bounds of torques in both directions, for joints that are bounded and that any contact loads."""
    size = np.linalg.norm(problem.torque_rows, axis=-1)
    is_active = np.isfinite(problem.torque_max) & (size > 0)
    rows = problem.torque_rows[is_active] / size[is_active, None]
    bounds = problem.torque_max[is_active] / size[is_active]
    return np.concatenate([rows, -rows]), np.concatenate([bounds, bounds])


def _apart(rows: np.ndarray) -> np.ndarray:
    """Expand rows of each contact's own force ``(m, k, 3)`` to rows of all forces ``(m k, 3m)``."""
    contacts, count = rows.shape[:2]
    wide = np.zeros((contacts, count, contacts, 3))
    wide[np.arange(contacts), :, np.arange(contacts)] = rows
    return wide.reshape(contacts * count, 3 * contacts)
