"""Friction pyramids and limits as rows of inequalities, rows . forces <= bounds, each row of unit length.

So a slack is a distance in the space of contact forces [N], whatever the row is about.
"""

from typing import Literal

import numpy as np

from jaxgrasp.literature.host_problem import HostProblem

Pyramid = Literal["inscribed", "circumscribed"]
"""Edges on the cone, so that all forces are ones that friction allows; or facets on the cone, which contain it."""


def check_pyramid(sides: int, pyramid: Pyramid) -> None:
    """Raise for pyramids that there are not."""
    if sides < 3:
        raise ValueError(f"sides is {sides}: expected 3 or more")
    if pyramid not in ("inscribed", "circumscribed"):
        raise ValueError(f"pyramid is {pyramid!r}: expected 'inscribed' or 'circumscribed'")


def constraint_rows(problem: HostProblem, sides: int, pyramid: Pyramid) -> tuple[np.ndarray, np.ndarray]:
    """All inequalities: facets, then normal forces from below and above, then torques both ways."""
    parts = (facet_rows(problem, sides, pyramid), normal_rows(problem), torque_rows(problem))
    rows, bounds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rows, bounds


def facet_rows(problem: HostProblem, sides: int, pyramid: Pyramid) -> tuple[np.ndarray, np.ndarray]:
    """``(m sides, 3m)`` facets; the first edge leans towards the first tangent.

    Where the edges point depends on the frame, and jumps as a normal turns.
    """
    angles = (2 * np.arange(sides) + 1) * np.pi / sides
    around = np.stack([np.cos(angles), np.sin(angles)], -1)
    slope = problem.friction * (np.cos(np.pi / sides) if pyramid == "inscribed" else 1.0)
    outward = np.einsum("kt,mtc->mkc", around, problem.tangents)
    rows = (outward - slope[:, None, None] * problem.normals[:, None]) / np.sqrt(1 + slope**2)[:, None, None]
    return _apart(rows), np.zeros(rows.shape[0] * sides)


def normal_rows(problem: HostProblem) -> tuple[np.ndarray, np.ndarray]:
    """No pulling, nor less than a preload; and no more than the largest normal forces, where these are bounded."""
    normals = _apart(problem.normals[:, None])
    bounded = np.isfinite(problem.normal_max)
    rows = np.concatenate([-normals, normals[bounded]])
    return rows, np.concatenate([-problem.normal_min, problem.normal_max[bounded]])


def torque_rows(problem: HostProblem) -> tuple[np.ndarray, np.ndarray]:
    """Torques in either direction, of the joints that are bounded and that any contact loads."""
    size = np.linalg.norm(problem.torque_rows, axis=-1)
    kept = np.isfinite(problem.torque_max) & (size > 0)
    rows = problem.torque_rows[kept] / size[kept, None]
    bounds = problem.torque_max[kept] / size[kept]
    return np.concatenate([rows, -rows]), np.concatenate([bounds, bounds])


def _apart(rows: np.ndarray) -> np.ndarray:
    """Rows of each contact's own force ``(m, k, 3)`` as rows of all forces ``(m k, 3m)``."""
    contacts, each = rows.shape[:2]
    wide = np.zeros((contacts, each, contacts, 3))
    wide[np.arange(contacts), :, np.arange(contacts)] = rows
    return wide.reshape(contacts * each, 3 * contacts)
