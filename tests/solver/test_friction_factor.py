"""The least factor of friction by one search: known answers, and bounds that prove them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver.friction_factor import least_friction_factor
from jaxgrasp.solver.wrench_boundary import with_unit_weights

FRICTION, TORSION, LIFT = 0.5, 0.02, 2.0


@pytest.mark.slow
def test_a_pinch_by_soft_fingers_shares_its_friction_between_lift_and_turning():
    """Each finger presses with half the total p, lifts t and turns m: |(t / (factor mu), m / gamma)| = p."""
    count = 40
    rng = np.random.default_rng(3)
    total, turning = rng.uniform(3, 30, count), rng.uniform(0, 0.9, count)
    moment = turning * TORSION * total
    wrench = np.zeros((count, 6))
    wrench[:, 2], wrench[:, 3] = LIFT, moment
    points = np.array([[[1.0, 0, 0], [-1.0, 0, 0]]]).repeat(count, 0)
    units = np.ones((count, 2))
    fields = (points, -points, FRICTION * units, units, None, units, wrench)
    batch = ProblemBatch(*(None if x is None else jnp.asarray(x) for x in fields), torsion=jnp.asarray(TORSION * units))

    def search(batch, total):
        problem = with_unit_weights(batch)
        return least_friction_factor(
            problem, total / problem.scaling.force_unit, jnp.zeros((1, count), bool), jnp.asarray(10.0)
        )

    search_result = jax.jit(search)(batch, jnp.asarray(total)[None])
    expected = LIFT / 2 / (FRICTION * np.sqrt((total / 2) ** 2 - (moment / 2 / TORSION) ** 2))
    proven = np.asarray(search_result.proven)
    # Those that are not are looked for otherwise, by whoever asks.
    assert proven.mean() > 0.8 and search_result.spent[proven].all()
    np.testing.assert_allclose(search_result.factor[proven], expected[proven], rtol=1e-9)
    assert (np.asarray(search_result.lower) <= expected * (1 + 1e-9)).all()
