"""The kernel as one of Warp's, a thread for each problem: for GPUs of NVIDIA, called from JAX by ``warp.jax_kernel``.

Warp compiles the same headers by NVRTC. Its processor runs the kernel too, by a call back to Python: tests use that.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, no_type_check

from jaxgrasp.kernel.compiled import CODES, INPUTS, OUTPUTS, Variant, build_options, initialised_warp, quiet

REGISTER_CONTACTS = 16
"""Up to so many contacts a variant is compiled for exactly their number, which loops over registers need."""
NUMBERS = ("n_contacts", "shared", "optimum")


@cache
@no_type_check  # Warp reads the annotations of its functions, and their source.
def gpu_kernel(variant: Variant) -> Any:
    """Return the Warp kernel of a variant: 11 arrays of a batch, three numbers, 12 arrays of a solution; all flat.

    ``shared`` has bit i set where all problems share array i; an array without elements is not given. ``optimum`` is 1
    for the constrained optimum, 0 for the closed form.
    """
    warp = initialised_warp()
    real = warp.array(dtype=warp.float64 if variant.dtype == "float64" else warp.float32)
    integers = dict.fromkeys(NUMBERS, warp.int32) | dict.fromkeys(CODES, warp.array(dtype=warp.int32))
    # In the order of the arguments, on which Warp relies.
    types = {name: integers.get(name, real) for name in (*INPUTS, *NUMBERS, *OUTPUTS)}
    type_name = variant.template_arguments.split(",")[0]
    snippet = f"""
    jaxgrasp::Batch<{type_name}> batch;
    const {type_name}* inputs[] = {{{", ".join(f"{name}.data" for name in INPUTS)}}};
    const int lengths[] = {{{", ".join(f"{name}.shape[0]" for name in INPUTS)}}};
    for (int i = 0; i < batch.INPUTS; i++) {{
      batch.inputs[i] = lengths[i] > 0 ? inputs[i] : nullptr;
      batch.strides[i] = (shared >> i & 1) == 0;
    }}
    batch.n_contacts = n_contacts;
    jaxgrasp::SolutionArrays<{type_name}> none = {{}};
    jaxgrasp::SolutionArrays<{type_name}> out = {{{", ".join(f"{name}.data" for name in OUTPUTS)}}};
    batch.closed_form = optimum ? none : out;
    batch.optimum = optimum ? out : none;
    jaxgrasp::solve_in_batch<{variant.template_arguments}>(batch, thread);
    """

    # fmt: off
    def solve_in_batch(
        points, normals, friction, squeeze, wrench, weights, present, torsion, normal_min, normal_max, start,
        n_contacts, shared, optimum,
        forces, multiplier, residual, objective, certificate, force_bound, moments, normal_multiplier,
        verdict, steps, route, rank, thread,
    ): ...

    solve_in_batch.__annotations__ = types | {"thread": warp.int32}
    solve_in_batch = warp.func_native(snippet)(solve_in_batch)

    def solve_batch(
        points, normals, friction, squeeze, wrench, weights, present, torsion, normal_min, normal_max, start,
        n_contacts, shared, optimum,
        forces, multiplier, residual, objective, certificate, force_bound, moments, normal_multiplier,
        verdict, steps, route, rank,
    ):
        solve_in_batch(
            points, normals, friction, squeeze, wrench, weights, present, torsion, normal_min, normal_max, start,
            n_contacts, shared, optimum,
            forces, multiplier, residual, objective, certificate, force_bound, moments, normal_multiplier,
            verdict, steps, route, rank, warp.tid(),
        )
    # fmt: on

    solve_batch.__annotations__ = types
    options = {"extra_build_options": build_options("batch.h")}
    return warp.kernel(solve_batch, module="unique", enable_backward=False, module_options=options)


@cache
def jax_kernel(variant: Variant) -> Callable[..., list]:
    """Return the kernel as a function of JAX's flat arrays, which also takes ``launch_dims`` and ``output_dims``."""
    warp = initialised_warp()
    kernel = gpu_kernel(variant)
    # Loaded here, since Warp prints a line for each module that it compiles later.
    with quiet(warp.config):
        kernel.module.load(warp.get_device())
    return warp.jax_kernel(kernel, num_outputs=len(OUTPUTS))
