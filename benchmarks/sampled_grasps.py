"""Grasps as sampling makes them, many of which cannot hold their load."""

import numpy as np

from jaxgrasp.testing.problem_data import Problems

LIFT = 3.0
"""Force of a lift [N]."""


def sampled(n: int, batch: int, lift: bool) -> Problems:
    """Contacts at random on a unit sphere, pressing inward; any wrench, or a lift by the upper half alone."""
    rng = np.random.default_rng([n, lift])
    points = rng.normal(size=(batch, n, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    wrench = rng.normal(size=(batch, 6)) * np.repeat([1.0, 0.3], 3)
    if lift:
        points[..., 2] = np.abs(points[..., 2])
        wrench = np.tile([0, 0, LIFT, 0, 0, 0], (batch, 1))
    friction, squeeze = rng.uniform(0.2, 0.6, (batch, n)), rng.uniform(0.5, 5, (batch, n))
    return Problems("lift" if lift else "any", points, -points, friction, squeeze, wrench, None)
