"""The kernel as one of Warp's, a thread for each problem: for GPUs of NVIDIA, called from JAX by ``warp.jax_kernel``.

Warp compiles the same headers by NVRTC. Its processor runs the kernel too, by a call back to Python: tests use that.
"""

# Annotations of Warp's functions are values.
# mypy: disable-error-code="valid-type"

from collections.abc import Callable
from functools import cache
from typing import Any, no_type_check

from jaxgrasp.kernel.compiled import Variant, build_options, initialised_warp, quiet

REGISTER_CONTACTS = 16
"""Up to so many contacts a variant is compiled for exactly their number, which loops over registers need."""
OUTPUTS = 12


@cache
@no_type_check  # Warp reads the annotations of its functions, and their source.
def gpu_kernel(variant: Variant) -> Any:
    """Return the Warp kernel of a variant: 11 arrays of a batch, three numbers, 12 arrays of a solution; all flat.

    ``shared`` has bit i set where all problems share array i; an array without elements is not given. ``optimum`` is 1
    for the constrained optimum, 0 for the closed form.
    """
    warp = initialised_warp()
    real, integer = (warp.float64 if variant.dtype == "float64" else warp.float32), warp.int32
    type_name = variant.template_arguments.split(",")[0]
    snippet = f"""
    jaxgrasp::Batch<{type_name}> batch;
    const {type_name}* inputs[] = {{points.data, normals.data, friction.data, squeeze.data, wrench.data, weights.data,
                                    present.data, torsion.data, normal_min.data, normal_max.data, start.data}};
    const int lengths[] = {{points.shape[0], normals.shape[0], friction.shape[0], squeeze.shape[0], wrench.shape[0],
                            weights.shape[0], present.shape[0], torsion.shape[0], normal_min.shape[0],
                            normal_max.shape[0], start.shape[0]}};
    for (int i = 0; i < 11; i++) {{
      batch.inputs[i] = lengths[i] > 0 ? inputs[i] : nullptr;
      batch.strides[i] = (shared >> i & 1) == 0;
    }}
    batch.n_contacts = n_contacts;
    jaxgrasp::SolutionArrays<{type_name}> none = {{}};
    jaxgrasp::SolutionArrays<{type_name}> out = {{
        forces.data, multiplier.data, residual.data, objective.data, certificate.data, force_bound.data, moments.data,
        normal_multiplier.data, verdict.data, steps.data, route.data, rank.data}};
    batch.closed_form = optimum ? none : out;
    batch.optimum = optimum ? out : none;
    jaxgrasp::solve_in_batch<{variant.template_arguments}>(batch, thread);
    """

    @warp.func_native(snippet)
    def solve_in_batch(
        points: warp.array(dtype=real),
        normals: warp.array(dtype=real),
        friction: warp.array(dtype=real),
        squeeze: warp.array(dtype=real),
        wrench: warp.array(dtype=real),
        weights: warp.array(dtype=real),
        present: warp.array(dtype=real),
        torsion: warp.array(dtype=real),
        normal_min: warp.array(dtype=real),
        normal_max: warp.array(dtype=real),
        start: warp.array(dtype=real),
        n_contacts: integer,
        shared: integer,
        optimum: integer,
        forces: warp.array(dtype=real),
        multiplier: warp.array(dtype=real),
        residual: warp.array(dtype=real),
        objective: warp.array(dtype=real),
        certificate: warp.array(dtype=real),
        force_bound: warp.array(dtype=real),
        moments: warp.array(dtype=real),
        normal_multiplier: warp.array(dtype=real),
        verdict: warp.array(dtype=integer),
        steps: warp.array(dtype=integer),
        route: warp.array(dtype=integer),
        rank: warp.array(dtype=integer),
        thread: integer,
    ): ...

    @warp.kernel(
        module="unique", enable_backward=False, module_options={"extra_build_options": build_options("batch.h")}
    )
    def solve_batch(
        points: warp.array(dtype=real),
        normals: warp.array(dtype=real),
        friction: warp.array(dtype=real),
        squeeze: warp.array(dtype=real),
        wrench: warp.array(dtype=real),
        weights: warp.array(dtype=real),
        present: warp.array(dtype=real),
        torsion: warp.array(dtype=real),
        normal_min: warp.array(dtype=real),
        normal_max: warp.array(dtype=real),
        start: warp.array(dtype=real),
        n_contacts: integer,
        shared: integer,
        optimum: integer,
        forces: warp.array(dtype=real),
        multiplier: warp.array(dtype=real),
        residual: warp.array(dtype=real),
        objective: warp.array(dtype=real),
        certificate: warp.array(dtype=real),
        force_bound: warp.array(dtype=real),
        moments: warp.array(dtype=real),
        normal_multiplier: warp.array(dtype=real),
        verdict: warp.array(dtype=integer),
        steps: warp.array(dtype=integer),
        route: warp.array(dtype=integer),
        rank: warp.array(dtype=integer),
    ):
        solve_in_batch(
            points,
            normals,
            friction,
            squeeze,
            wrench,
            weights,
            present,
            torsion,
            normal_min,
            normal_max,
            start,
            n_contacts,
            shared,
            optimum,
            forces,
            multiplier,
            residual,
            objective,
            certificate,
            force_bound,
            moments,
            normal_multiplier,
            verdict,
            steps,
            route,
            rank,
            warp.tid(),
        )

    return solve_batch


@cache
def jax_kernel(variant: Variant) -> Callable[..., list]:
    """Return the kernel as a function of JAX's flat arrays, which also takes ``launch_dims`` and ``output_dims``."""
    warp = initialised_warp()
    with quiet(warp.config):
        return warp.jax_kernel(gpu_kernel(variant), num_outputs=OUTPUTS)
