"""The pages of limited hands, mixed batches and other objectives: those of committed results, of what they say."""

import json

import numpy as np
import pytest

from benchmarks.page import limited_tables, mixed_tables, objective_tables
from benchmarks.readme import RESULTS
from benchmarks.sampled_grasps import BOX, FAMILIES, LIFT, RADIUS

PAGES = [("limited_hands", limited_tables), ("mixed", mixed_tables), ("objectives", objective_tables)]


@pytest.mark.parametrize(("name", "tables"), PAGES)
def test_the_page_is_that_of_the_committed_results(name, tables):
    report = json.loads((RESULTS / f"{name}.json").read_text())
    assert tables.page(report) == (RESULTS / f"{name}.md").read_text()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_is_what_its_page_says(name):
    """Unit normals, every grasp of as many contacts as asked for, and loads as the page describes them."""
    family = FAMILIES[name](3, 40)
    assert family.kind == name and name in mixed_tables.LOADS
    assert family.points.shape == family.normals.shape == (40, 3, 3)
    assert family.friction.shape == family.squeeze.shape == (40, 3) and family.wrench.shape == (40, 6)
    np.testing.assert_allclose(np.linalg.norm(family.normals, axis=-1), 1, atol=1e-6)
    if name in ("lift", "carton", "bottle"):
        np.testing.assert_allclose(np.linalg.norm(family.wrench[:, :3], axis=-1), LIFT, rtol=1e-12)
    if name == "carton":
        depths = np.array(BOX) - np.abs(family.points)
        np.testing.assert_allclose(depths.min(-1), 0, atol=1e-15)
    if name == "bottle":
        np.testing.assert_allclose(np.hypot(*family.points[..., :2].T), RADIUS, rtol=1e-12)
