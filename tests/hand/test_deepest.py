"""Selection of the deepest contacts where there are more than fit."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.hand import Contacts, keep_deepest


def contacts(seed: int = 0) -> Contacts:
    rng = np.random.default_rng(seed)
    present = (rng.uniform(size=(6, 9)) < 0.7).astype(float)
    present[0], present[1] = 0, 1
    depths = rng.uniform(1e-4, 1e-3, (6, 9)) * present
    arrays = (rng.normal(size=(6, 9, 3)), rng.normal(size=(6, 9, 3)), depths, present, np.ones(6, np.int32))
    return Contacts(*map(jnp.asarray, arrays))


@pytest.mark.parametrize("size", [1, 4, 9, 20])
def test_the_deepest_are_kept_and_the_others_counted(size):
    touches = contacts()
    deepest = jax.jit(keep_deepest, static_argnums=1)(touches, size)
    width = min(size, 9)
    assert deepest.contacts.depths.shape == (6, width)
    for i in range(6):
        order = np.argsort(-np.asarray(touches.depths[i]))[:width]
        np.testing.assert_array_equal(deepest.contacts.depths[i], touches.depths[i][order])
        is_present = np.asarray(deepest.contacts.present[i]) > 0
        np.testing.assert_array_equal(np.asarray(deepest.links[i])[is_present], order[: is_present.sum()])
        for name in ("points", "normals"):
            np.testing.assert_array_equal(
                getattr(deepest.contacts, name)[i][is_present], getattr(touches, name)[i][order][is_present]
            )
        assert is_present.sum() == min(width, touches.present[i].sum())
        assert deepest.dropped[i] == touches.present[i].sum() - is_present.sum()


def test_alone_is_as_in_a_batch():
    touches = contacts()
    alone = keep_deepest(jax.tree.map(lambda x: x[3], touches), 4)
    np.testing.assert_array_equal(alone.contacts.points, keep_deepest(touches, 4).contacts.points[3])


def test_what_cannot_be_told_is_not_dropped():
    touches = contacts()
    spoilt = eqx.tree_at(lambda c: c.present, touches, touches.present.at[1, 7].set(jnp.nan))
    assert np.isnan(np.asarray(keep_deepest(spoilt, 2).contacts.present[1])).any()


def test_no_room_at_all_is_refused():
    with pytest.raises(ValueError, match="size is 0: expected at least one contact"):
        keep_deepest(contacts(), 0)
