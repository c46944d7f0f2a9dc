"""MuJoCo's own contact forces as a witness: no optimum may be worse than forces that are known to be allowed.

For every set of the shipped file, w' is the wrench that MuJoCo's contact forces exert on the object. These
forces balance w' and respect the cones, so w' is feasible, and a minimum over all such forces is no larger
than what MuJoCo found. The engine's forces leave their cones by rounding: they are first put back (no pull, and
the tangential part shrunk to what friction allows), and w' is computed from what is left, so the law is exact.
"""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import jaxgrasp

pytestmark = pytest.mark.slow

PATH = Path(importlib.util.find_spec("jaxgrasp").submodule_search_locations[0]) / "data" / "simulated_grips.npz"
SLACK = 1e-9
"""Relative, of objectives and forces: a few times the duality gap at which the solver stops in double precision."""
OUTSIDE = 1e-4
"""[N]: more than any of the engine's forces, stored in single precision, lies outside its cone."""
METHODS = ("A-optimum", "B-optimum")


@pytest.fixture(scope="module")
def sets():
    return jaxgrasp.load_grasps(PATH)


@pytest.fixture(scope="module")
def witness(sets):
    """Return MuJoCo's forces, projected into the cones."""
    with np.load(PATH, allow_pickle=False) as file:
        simulated = file["simulated_force"].astype(float)
    pressing = np.maximum(along(sets.normals, simulated), 0)
    sliding = simulated - along(sets.normals, simulated)[:, None] * sets.normals
    size = np.linalg.norm(sliding, axis=-1)
    shrink = np.minimum(1, sets.friction * pressing / np.where(size > 0, size, 1))
    forces = pressing[:, None] * sets.normals + shrink[:, None] * sliding
    assert np.abs(forces - simulated).max() <= OUTSIDE
    return forces


@pytest.fixture(scope="module")
def wrench(sets, witness):
    return wrench_of(sets, witness)


@pytest.fixture(scope="module")
def results(sets, wrench):
    return jaxgrasp.evaluate(sets, wrench, methods=METHODS, dtype="float64").results


def along(normals, forces):
    return np.einsum("ij,ij->i", forces, normals)


def per_set(sets, values):
    return np.add.reduceat(values, sets.offsets[:-1])


def wrench_of(sets, forces):
    return np.concatenate([per_set(sets, forces), per_set(sets, np.cross(sets.points, forces))], -1)


def objective(sets, forces, method):
    """Compute F_2 (eq. 5) or F_3 (eq. 13), straight from the formula."""
    weights = sets.squeeze if method == "B-optimum" else np.ones_like(sets.squeeze)
    apart = forces - sets.squeeze[:, None] * sets.normals
    return per_set(sets, (apart**2).sum(-1) / (2 * weights))


@pytest.mark.parametrize("method", METHODS)
def test_a_wrench_that_mujoco_reaches_is_feasible(results, method):
    solved = np.isin(results[method].verdict[:, 0], (jaxgrasp.Verdict.CLOSED_FORM_OPTIMAL, jaxgrasp.Verdict.OPTIMAL))
    assert not np.flatnonzero(~solved).tolist()


@pytest.mark.parametrize("method", METHODS)
def test_the_optimum_is_no_worse_than_mujoco(sets, witness, results, method):
    bound = objective(sets, witness, method)
    worse = results[method].objective[:, 0] > bound * (1 + SLACK)
    assert not np.flatnonzero(worse).tolist()


@pytest.mark.parametrize("method", METHODS)
def test_the_optimum_is_what_it_says(sets, wrench, results, method):
    """Without this an objective could be small because the forces balance another wrench or slip."""
    forces = results[method].forces[:, 0]
    pressing = along(sets.normals, forces)
    sliding = np.linalg.norm(forces - pressing[:, None] * sets.normals, axis=-1)
    total = per_set(sets, np.linalg.norm(forces, axis=-1))
    reach = np.sqrt(np.maximum.reduceat((sets.points**2).sum(-1), sets.offsets[:-1]))
    residual = np.abs(wrench_of(sets, forces) - wrench)
    assert (residual[:, :3].max(-1) <= SLACK * total).all() and (residual[:, 3:].max(-1) <= SLACK * total * reach).all()
    assert (sliding <= sets.friction * pressing + SLACK * np.repeat(total, sets.sizes)).all()
    np.testing.assert_allclose(results[method].objective[:, 0], objective(sets, forces, method), rtol=SLACK)
