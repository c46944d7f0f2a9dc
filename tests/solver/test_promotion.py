"""Users may forbid what JAX promotes by itself: ranks and dtypes are our own business."""

import jax
import jax.numpy as jnp
import pytest

import jaxgrasp
from jaxgrasp.testing import problems as P
from tests.turns import in_turns


def by_squeeze(question):
    def gradient(grasp, wrench):
        def total(squeeze):
            moved = jaxgrasp.Grasp(grasp.points, grasp.normals, grasp.friction, squeeze)
            return jnp.sum(question(moved, wrench))

        return jax.grad(total)(grasp.squeeze)

    return gradient


QUESTIONS = {
    "closed form": by_squeeze(lambda g, w: jaxgrasp.closed_form(g, w).forces),
    "optimum": by_squeeze(lambda g, w: jaxgrasp.constrained_optimum(g, w).forces),
    "guided": by_squeeze(lambda g, w: jaxgrasp.constrained_optimum(g, w, free=w[..., None]).forces),
    "margin": by_squeeze(lambda g, w: jaxgrasp.wrench_margin(g, w, w)),
    "least squeeze": jaxgrasp.least_squeeze,
    "least friction": jaxgrasp.least_friction,
    "reachable": jaxgrasp.reachable_wrench,
    "certificate": lambda g, w: jaxgrasp.verify_certificate(g, w, w),
}

QUICK = ("closed form", "optimum", "certificate")


@pytest.mark.repeats
@pytest.mark.parametrize("question", in_turns(QUESTIONS, QUICK))
def test_nothing_is_promoted(question):
    some = P.problems("ordinary", 4, 20, seed=3)
    grasp = jaxgrasp.Grasp(some.points, some.normals, some.friction, some.squeeze)
    arrays = jax.tree.map(jnp.asarray, (grasp, some.wrench))
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        answer = jax.tree.leaves(jax.eval_shape(QUESTIONS[question], *arrays))
    assert answer and all(leaf.shape[0] == 20 for leaf in answer)
