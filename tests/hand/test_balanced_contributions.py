"""Contributions by which squeezing forces balance: against SciPy's least squares, wherever the hand lies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import balanced_contributions
from jaxgrasp.hand import Contacts
from jaxgrasp.hand.to_grasp import FAITHFUL

COUNT = 12


def contacts(seed: int, open_: int = 3) -> Contacts:
    """Return contacts all around a ball, pressed in by a millimetre or so; some links do not touch."""
    rng = np.random.default_rng(seed)
    out = rng.normal(size=(COUNT, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    normals = -out + 0.2 * rng.normal(size=out.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    depths = rng.uniform(5e-4, 2e-3, COUNT)
    present = (np.arange(COUNT) >= open_).astype(float)
    return Contacts(*map(jnp.asarray, (0.03 * out, normals, depths, present, 0)))


def on_device(touches: Contacts) -> Contacts:
    return jax.tree.map(jnp.asarray, touches)


def squeezing(touches: Contacts, contributions) -> np.ndarray:
    """Compute the wrench of all squeezing forces about the origin, with lengths in units of the grip (0.03 m)."""
    forces = np.asarray(contributions * touches.depths * touches.present)[:, None] * touches.normals
    return np.concatenate([forces.sum(0), np.cross(touches.points, forces).sum(0) / 0.03])


@pytest.mark.parametrize("seed", range(4))
def test_the_squeezing_forces_balance_and_stay_as_large(seed):
    touches, table = jax.device_get(contacts(seed)), np.random.default_rng(seed).uniform(0.1, 1, COUNT)
    made = np.asarray(balanced_contributions(on_device(touches), table, np.zeros(3)))
    assert (made >= 0).all() and np.array_equal(made[:3], table[:3])
    before, after = (np.linalg.norm(squeezing(touches, c)) for c in (table, made))
    assert after < 0.25 * before
    held = touches.depths * touches.present
    assert held @ made == pytest.approx(held @ table, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_they_are_the_nearest_by_another_solver(seed):
    touches, table = jax.device_get(contacts(seed)), np.random.default_rng(seed).uniform(0.1, 1, COUNT)
    made = np.asarray(balanced_contributions(on_device(touches), table, np.zeros(3)))[3:]
    weights = touches.depths[3:] / touches.depths[3:].mean()
    columns = (
        np.concatenate([touches.normals, np.cross(touches.points, touches.normals) / 0.03], 1)[3:] * weights[:, None]
    ).T
    system = np.concatenate([columns, np.diag(FAITHFUL * weights)])
    targets = np.concatenate([np.zeros(6), FAITHFUL * weights * table[3:]])
    nearest = lsq_linear(system, targets, (0, np.inf), tol=1e-14).x
    np.testing.assert_allclose(made, nearest * (weights @ table[3:]) / (weights @ nearest), rtol=1e-5, atol=1e-7)


def test_they_do_not_hang_on_where_and_how_hard():
    touches, table = jax.device_get(contacts(5)), np.linspace(0.2, 1, COUNT)
    made = balanced_contributions(on_device(touches), table, np.zeros(3))
    turn, shift = Rotation.random(random_state=0).as_matrix(), np.array([0.3, -0.2, 1.0])
    parts = (
        touches.points @ turn.T + shift,
        touches.normals @ turn.T,
        3 * touches.depths,
        touches.present,
        touches.tests,
    )
    moved = Contacts(*map(jnp.asarray, parts))
    np.testing.assert_allclose(balanced_contributions(moved, table, shift), made, rtol=1e-6)
    np.testing.assert_allclose(
        balanced_contributions(on_device(touches), 7 * table, np.zeros(3)), 7 * np.asarray(made), rtol=1e-6
    )


def test_without_contacts_nothing_changes():
    touches = contacts(0, open_=COUNT)
    np.testing.assert_array_equal(balanced_contributions(touches, np.ones(COUNT), jnp.zeros(3)), 1)
