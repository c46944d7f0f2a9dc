"""The solver as single kernels, and as the plain functions that they are where XLA is not known to make them."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Verdict
from jaxgrasp.numerics import fused_cpu_kernel
from jaxgrasp.testing import problems as P

FIELDS = ("points", "normals", "friction", "squeeze")


def answers(grasp, wrench):
    return jax.device_get(jaxgrasp.closed_form_and_optimum(grasp, wrench))


@pytest.mark.slow
def test_plain_functions_have_the_same_answers(monkeypatch):
    kinds = [P.problems(kind, 3, 60, seed=11) for kind in ("ordinary", "combined", "limit_101")]
    arrays = (np.concatenate([getattr(some, name) for some in kinds]) for name in FIELDS)
    grasp, wrench = jaxgrasp.Grasp(*arrays), np.concatenate([some.wrench for some in kinds])
    kernels = answers(grasp, wrench)
    monkeypatch.setattr(fused_cpu_kernel, "is_known_xla", lambda: False)
    jax.clear_caches()
    plain = answers(grasp, wrench)
    jax.clear_caches()
    for with_kernels, with_functions in zip(kernels, plain, strict=True):
        np.testing.assert_array_equal(with_kernels.verdict, with_functions.verdict)
        answered = with_kernels.verdict <= Verdict.OUTSIDE_CONES
        apart = np.abs(with_kernels.forces - with_functions.forces).max((1, 2)) / (
            1 + np.abs(with_kernels.forces).max((1, 2))
        )
        # Both round in their own way; an optimum is judged by its gap, to 1e-8 of the objective.
        assert apart[answered].max() < 1e-6
        assert np.median(apart[answered]) < 1e-12
