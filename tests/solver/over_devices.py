"""Four devices of one machine, or two processes of two each: ``test_over_devices`` runs it, and reads its JSON file."""

import json
import sys
from pathlib import Path

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import jaxgrasp
from jaxgrasp.testing.problems import problems


def apart(solution, alone) -> float:
    return float(np.max(np.abs(np.asarray(solution.forces) - np.asarray(alone.forces))))


def drawn(count: int):
    some = problems("ordinary", 4, count, seed=3)
    return jaxgrasp.Grasp(some.points, some.normals, some.friction, some.squeeze), some.wrench


def of_one_machine() -> dict:
    outcomes = {}
    for count, devices in ((1, 2), (30, 3), (230, 4)):
        grasp, wrench = drawn(count)
        alone = jaxgrasp.constrained_optimum(grasp, wrench)
        solution = jaxgrasp.constrained_optimum(grasp, wrench, devices=devices)
        outcomes[f"{count} on {devices}"] = [
            apart(solution, alone),
            len(solution.forces.devices()),
            np.array_equal(solution.verdict, alone.verdict),
        ]
    grasp, wrench = drawn(6)
    single = jax.tree.map(lambda x: x[0], grasp)
    alone, solution = (
        jaxgrasp.closed_form(single, some_wrench, "uniform", devices=devices)
        for some_wrench, devices in ((wrench, None), (wrench.reshape(2, 3, 6), 2))
    )
    outcomes["one grasp for all"] = [
        apart(jax.tree.map(lambda x: x.reshape(6, *x.shape[2:]), solution), alone),
        2,
        True,
    ]
    both_solutions = jaxgrasp.closed_form_and_optimum(grasp, wrench, devices=2)
    outcomes["both"] = [apart(both_solutions[1], jaxgrasp.constrained_optimum(grasp, wrench)), 2, True]
    return outcomes


def of_two_processes(port: str, number: str) -> dict:
    jax.distributed.initialize(f"127.0.0.1:{port}", num_processes=2, process_id=int(number))
    grasp, wrench = drawn(32)
    mesh, axes = Mesh(np.array(jax.devices()), ("problem",)), PartitionSpec("problem")
    half = slice(16 * int(number), 16 * (int(number) + 1))
    own_half = jax.tree.map(lambda x: np.asarray(x)[half], (grasp, wrench))
    shared_arrays = jax.tree.map(
        lambda x: jax.make_array_from_process_local_data(NamedSharding(mesh, axes), x), own_half
    )
    solve = jax.shard_map(jaxgrasp.constrained_optimum, mesh=mesh, in_specs=axes, out_specs=axes, check_vma=False)
    forces = jax.jit(lambda arrays: solve(*arrays).forces)(shared_arrays)
    mine = np.concatenate([np.asarray(part.data) for part in sorted(forces.addressable_shards, key=lambda s: s.index)])
    alone = jaxgrasp.constrained_optimum(*own_half)
    local_solution = jaxgrasp.constrained_optimum(*own_half, devices=2)
    evaluated = jaxgrasp.evaluate(*own_half, methods=("B-optimum",)).results["B-optimum"].forces.reshape(16, 4, 3)
    multihost_utils.sync_global_devices("done")
    return {
        "processes": [float(np.max(np.abs(mine - np.asarray(alone.forces)))), len(jax.devices()), len(mine) == 16],
        "local": [apart(local_solution, alone), 4, True],
        "evaluate": [float(np.max(np.abs(evaluated - np.asarray(alone.forces)))), 4, True],
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    output, *process = sys.argv[1:]
    # A file, since what connects processes writes to stdout too, in the middle of a line.
    Path(output).write_text(json.dumps(of_two_processes(*process) if process else of_one_machine()))
