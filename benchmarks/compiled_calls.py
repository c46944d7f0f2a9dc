"""Cost of each public call before its first answer: run by ``benchmarks.compile``, in a process of its own.

It reads nothing of the project but ``jaxgrasp``, so that it measures any version of it: ``python -c`` of this text, in
that version's folder, with the number of problems and the names of calls as arguments. Prints one line of JSON a call.
"""

import json
import re
import sys
import time

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_enable_compilation_cache", False)

import jax.numpy as jnp
import numpy as np

import jaxgrasp

CONTACTS, JOINTS = 5, 21


def problems(batch: int):
    """Return contacts on a unit sphere that press inward, and any wrench; like sampled grasps, some are hopeless."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(batch, CONTACTS, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    friction, squeeze = rng.uniform(0.2, 0.6, (batch, CONTACTS)), rng.uniform(0.5, 5, (batch, CONTACTS))
    grasp = jaxgrasp.Grasp(*map(jnp.asarray, (points, -points, friction, squeeze)))
    torque_map = rng.normal(size=(batch, CONTACTS, 3, JOINTS))
    limits = jaxgrasp.Limits(torque_map=jnp.asarray(torque_map), torque_max=jnp.full((batch, JOINTS), 20.0))
    return grasp, jnp.asarray(rng.normal(size=(batch, 6))), limits


def jacobian(grasp, wrench):
    def forces(squeeze, grasp, wrench):
        again = jaxgrasp.Grasp(grasp.points, grasp.normals, grasp.friction, squeeze)
        return jaxgrasp.constrained_optimum(again, wrench).forces

    return jax.vmap(jax.jacrev(forces))(grasp.squeeze, grasp, wrench)


def calls(batch: int) -> dict:
    grasp, wrench, limits = problems(batch)
    return {
        "closed_form": (lambda g, w: jaxgrasp.closed_form(g, w), (grasp, wrench)),
        "constrained_optimum": (lambda g, w: jaxgrasp.constrained_optimum(g, w), (grasp, wrench)),
        "its jacrev by squeeze": (jacobian, (grasp, wrench)),
        "with torque limits of 21 joints": (
            lambda g, w, x: jaxgrasp.constrained_optimum(g, w, limits=x),
            (grasp, wrench, limits),
        ),
        "least_squeeze": (lambda g, w: jaxgrasp.least_squeeze(g, w), (grasp, wrench)),
        "least_friction": (lambda g, w: jaxgrasp.least_friction(g, w), (grasp, wrench)),
        "wrench_margin": (lambda g, w: jaxgrasp.wrench_margin(g, w, w), (grasp, wrench)),
    }


def measured(call, arguments) -> dict:
    """Measure the CPU seconds of tracing and compiling inside a user's own program, and of a first call alone."""
    start = time.process_time()
    compiled = jax.jit(call).lower(*arguments).compile()
    inside = time.process_time() - start
    fusions = len(re.findall(r" fusion\(", compiled.as_text()))
    jax.clear_caches()
    start = time.process_time()
    jax.block_until_ready(call(*arguments))
    return {"inside": inside, "alone": time.process_time() - start, "fusions": fusions}


if __name__ == "__main__":
    batch, chosen_names = int(sys.argv[1]), sys.argv[2:]
    for name, (call, arguments) in calls(batch).items():
        if not chosen_names or name in chosen_names:
            print(json.dumps({"call": name, "batch": batch, **measured(call, arguments)}), flush=True)
