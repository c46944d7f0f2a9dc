"""Newton's method on the dual ends whatever it meets."""

import jax.numpy as jnp
import pytest

from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.scaled_problem import in_plain_axes
from jaxgrasp.solver.newton import DualObjective, maximise
from jaxgrasp.testing.problems import problems


@pytest.mark.parametrize("field", ["force", "squeeze"])
def test_a_search_that_meets_nan_is_stalled(field):
    """Else a phase without a limit on its checks would go on forever: products of extreme data may overflow."""
    p = problems("ordinary", 3, 1, seed=1)
    batch = ProblemBatch(p.points, p.normals, p.friction, p.squeeze, None, p.squeeze, p.wrench)
    scaled = in_plain_axes(batch)
    nan = {"force": Vec3(*jnp.full((3, 1, 1), jnp.nan)), "squeeze": scaled.data.squeeze + jnp.nan}[field]
    objective = DualObjective(scaled._replace(data=scaled.data._replace(**{field: nan})))
    state = maximise(objective, jnp.zeros((6, 1)), jnp.zeros((1, 1), bool), 50)
    assert state.done.all() and state.stalled.all()
