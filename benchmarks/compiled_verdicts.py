"""Verdicts of hard problems under one set of compile options: run by ``benchmarks.compile``, in a process of its own.

Prints one line of JSON: of each kind how many problems there were and how many stayed undecided.
"""

import json
import sys
from collections import defaultdict

import jax
import numpy as np

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P

SIZES = (1, 2, 3, 5, 10, 20)
SHARINGS = ("squeeze", "uniform")


def verdicts(count: int, seed: int = 3) -> dict[str, list[int]]:
    solve = jax.jit(lambda grasp, wrench, weights: jaxgrasp.constrained_optimum(grasp, wrench, weights).verdict)
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for n in SIZES:
        for kind in (kind for kind in P.KINDS if n >= P.LEAST_CONTACTS.get(kind, 1)):
            drawn = P.problems(kind, n, count, seed)
            grasp = Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)
            for sharing in SHARINGS:
                verdict = np.asarray(solve(grasp, drawn.wrench, drawn.weights(sharing)))
                counts[kind][0] += count
                counts[kind][1] += int(np.sum(verdict == Verdict.NOT_CONVERGED))
    return counts


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    print(json.dumps(verdicts(int(sys.argv[1]))))
