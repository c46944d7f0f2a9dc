"""Answers to problems that are spread over four devices of this machine.

``test_sharded.py`` runs this in a process of its own. Prints, as JSON, the largest difference from what one
device answers, and over how many devices the answers are spread.
"""

import json
import sys

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax.sharding import AxisType, NamedSharding, PartitionSpec  # noqa: E402

import jaxgrasp  # noqa: E402
from jaxgrasp.testing import problems as P  # noqa: E402


def forces(grasp, wrench):
    return jaxgrasp.constrained_optimum(grasp, wrench).forces


def closed(grasp, wrench):
    return jaxgrasp.closed_form(grasp, wrench).forces


def by_squeeze(grasp, wrench):
    def size(squeeze):
        moved = jaxgrasp.Grasp(grasp.points, grasp.normals, grasp.friction, squeeze)
        return jnp.sum(forces(moved, wrench) ** 2)

    return jax.grad(size)(grasp.squeeze)


def proven(grasp, wrench):
    return jaxgrasp.verify_certificate(grasp, wrench, wrench)


QUESTIONS = {"optimum": forces, "closed form": closed, "gradient": by_squeeze, "certificate": proven}


def answers(kind: str, count: int, names: list[str]) -> dict[str, dict[str, float]]:
    """Return for each question the largest relative difference from one device's answer, and its number of devices."""
    some = P.problems("ordinary", 3, count, seed=7)
    grasp = jaxgrasp.Grasp(some.points, some.normals, some.friction, some.squeeze)
    arrays = jax.tree.map(jnp.asarray, (grasp, some.wrench))
    alone = {name: np.asarray(QUESTIONS[name](*arrays)) for name in names}
    axes = PartitionSpec("batch")
    mesh = jax.make_mesh((4,), ("batch",), axis_types=(AxisType.Explicit if kind == "Explicit" else AxisType.Auto,))
    spread = jax.device_put(arrays, NamedSharding(mesh, axes))
    jax.set_mesh(mesh)  # which JAX asks for where axes are explicit
    outcomes = {}
    for name, expected in alone.items():
        ask = QUESTIONS[name]
        if kind == "Manual":
            ask = jax.shard_map(ask, mesh=mesh, in_specs=axes, out_specs=axes)
        for mode, solve in (("plain", ask), ("jit", jax.jit(ask))):
            solution = solve(*spread)
            apart = float(np.abs(np.asarray(solution) - expected).max() / np.abs(expected).max())
            outcomes[f"{name}, {mode}"] = {"apart": apart, "devices": len(solution.sharding.device_set)}
    return outcomes


if __name__ == "__main__":
    print(json.dumps(answers(sys.argv[1], int(sys.argv[2]), sys.argv[3].split(","))))
