"""Answers to a thousand problems of every kind: run by ``benchmarks.golden``, in a process of its own.

It reads nothing of the project but ``jaxgrasp``, so that any version of it can be asked: ``python -c`` of this text, in
that version's folder, with the file of problems and the file of answers as arguments.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxgrasp


def leaves(name: str, tree) -> dict[str, np.ndarray]:
    """Return the arrays of an answer, by the names of its fields."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {name + jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in paths}


def answers(data: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    grasp = jaxgrasp.Grasp(*(jnp.asarray(data[name]) for name in ("points", "normals", "friction", "squeeze")))
    wrench = jnp.asarray(data["wrench"])
    fields: dict[str, np.ndarray] = {}
    for sharing in ("squeeze", "uniform"):
        fields |= leaves(f"closed form, {sharing}: ", jaxgrasp.closed_form(grasp, wrench, sharing))
        optimum = jaxgrasp.constrained_optimum(grasp, wrench, sharing)
        fields |= leaves(f"optimum, {sharing}: ", optimum)
        proof = jaxgrasp.verify_certificate(grasp, wrench, optimum.certificate, sharing)
        fields |= leaves(f"certificate's proof, {sharing}", proof)

    def forces(question):
        return lambda parts: jnp.sum(question(jaxgrasp.Grasp(*parts[:4]), parts[4]).forces ** 2)

    parts = (grasp.points, grasp.normals, grasp.friction, grasp.squeeze, wrench)
    for question in (jaxgrasp.closed_form, jaxgrasp.constrained_optimum):
        slopes = jax.jit(jax.grad(forces(question)))(parts)
        fields |= leaves(f"derivative, {question.__name__}: ", slopes)
    return fields


def more_answers(data: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Answer the other questions about a grasp, with soft fingers and limits."""
    parts = [jnp.asarray(data[name]) for name in ("points", "normals", "friction", "squeeze")]
    grasp, wrench = jaxgrasp.Grasp(*parts), jnp.asarray(data["wrench"])
    soft = jaxgrasp.Grasp(*parts, torsion=jnp.asarray(data["torsion"]))
    limit_arrays = {name: jnp.asarray(data[name]) for name in ("normal_min", "normal_max", "torque_map", "torque_max")}
    limits = jaxgrasp.Limits(**limit_arrays)
    fields = leaves("limited: ", jaxgrasp.constrained_optimum(soft, wrench, "uniform", limits=limits))
    fields |= leaves("least squeeze", jaxgrasp.least_squeeze(grasp, wrench))
    fields |= leaves("least friction", jaxgrasp.least_friction(grasp, wrench))
    fields |= leaves("margin", jaxgrasp.wrench_margin(grasp, wrench, jnp.asarray(data["direction"])))
    fields |= leaves("reachable: ", jaxgrasp.reachable_wrench(grasp, wrench))
    fields |= leaves("least maximal force: ", jaxgrasp.best_forces(soft, wrench, "least_maximal_force", limits=limits))
    fields |= leaves("parts: ", jaxgrasp.split_forces(grasp, wrench))
    return fields


if __name__ == "__main__":
    with np.load(sys.argv[1]) as archive:
        problems: dict[int, dict[str, np.ndarray]] = {}
        for key in archive.files:
            n, name = key.split(" ")
            problems.setdefault(int(n), {})[name] = archive[key]
    out = {f"n = {n}, {name}": x for n, data in problems.items() for name, x in answers(data).items()}
    fewest = min(problems)
    out |= {f"n = {fewest}, {name}": x for name, x in more_answers(problems[fewest]).items()}
    np.savez(sys.argv[2], **out)
