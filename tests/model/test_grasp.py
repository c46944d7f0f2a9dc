"""A Grasp from lists is the one from arrays, and what is neither is named."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp

LISTS = {
    "points": [[1.0, 0, 0], [-1, 0, 0]],
    "normals": [[-1.0, 0, 0], [1, 0, 0]],
    "friction": [0.5, 0.5],
    "squeeze": [1, 2],
}


def test_lists_become_arrays():
    grasp = Grasp(**LISTS, present=[1, 1])
    arrays = Grasp(**{name: np.asarray(value, float) for name, value in LISTS.items()})
    wrench = np.array([0.0, 0, 0.1, 0, 0, 0])
    forces = [jaxgrasp.closed_form(g, wrench).forces for g in (grasp, arrays)]
    np.testing.assert_array_equal(*forces)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(grasp))


@pytest.mark.parametrize("name", LISTS)
@pytest.mark.parametrize("wrong", [[[1.0, 2], [3]], ["a", "b"]])
def test_what_is_no_array_is_named(name, wrong):
    with pytest.raises(ValueError, match=name):
        Grasp(**{**LISTS, name: wrong})
