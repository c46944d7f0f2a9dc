"""Small contact sets that the tests of this folder share."""

import numpy as np
import pytest

from jaxgrasp.batch.contact_sets import ContactSets


def make_sets(sizes, seed=0, wrenches=1) -> ContactSets:
    """Return grasps of these sizes on a ball of 5 cm, each with wrenches that forces inside the cones exert."""
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    count = offsets[-1]
    outward = rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    friction, squeeze = rng.uniform(0.3, 1, count), rng.uniform(1, 5, count)
    points = 0.05 * outward
    wrench = np.zeros((len(sizes), wrenches, 6))
    for w in range(wrenches):
        across = np.cross(outward, rng.normal(size=(count, 3)))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        along = squeeze * rng.uniform(0.3, 1.5, count)
        force = along[:, None] * (-outward + (0.95 * friction * rng.uniform(0, 1, count))[:, None] * across)
        contact_wrenches = np.concatenate([force, np.cross(points, force)], 1)
        wrench[:, w] = np.add.reduceat(contact_wrenches, offsets[:-1], axis=0)
    return ContactSets(points, -outward, friction, squeeze, offsets, wrench)


@pytest.fixture
def ragged() -> ContactSets:
    return make_sets([3, 5, 2, 4, 5, 3, 6])
