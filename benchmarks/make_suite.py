"""Make the file of the suite of hard problems, references included; mpmath is needed.

    python -m benchmarks.make_suite --out jaxgrasp/data/suite.npz

Problems that neither an optimum nor a certificate decides in extended precision stop it. A published file of a version
is never made anew: change ``jaxgrasp.testing.suite.VERSION`` first.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks import suite_problems, suite_references
from benchmarks.suite_references import pair
from jaxgrasp.testing.suite import FILE
from jaxgrasp.testing.suite_files import write_npz
from jaxgrasp.testing.suite_judge import judge, proves
from jaxgrasp.testing.suite_problem import SuiteProblem, frame

WITHIN = 1e-20
"""Largest error of a reference, by ``suite_judge``."""


def condition(problem: SuiteProblem) -> float:
    """Return the ratio of the extreme singular values of G W^(1/2), those of rounding left out."""
    coordinates = frame(problem)
    arms = np.asarray(coordinates.arms, float)
    blocks = []
    for arm, weight in zip(arms, problem.weights, strict=True):
        skew = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
        blocks.append(np.sqrt(weight / problem.weights.sum()) * np.concatenate([np.eye(3), skew]))
    sizes = np.linalg.svd(np.concatenate(blocks, 1), compute_uv=False)
    return float(sizes[0] / sizes[sizes > 1e-14 * sizes[0]].min())


def with_reference(problem: SuiteProblem) -> SuiteProblem:
    """Return the problem with its reference and condition numbers.

    Raises:
        ValueError: where the judge refuses the reference.
    """
    problem = problem._replace(grasp_condition=condition(problem))
    n, joints = len(problem.friction), 0 if problem.torque_max is None else len(problem.torque_max)
    if problem.feasible:
        reference = suite_references.optimum(problem)
        problem = problem._replace(
            forces=pair(reference.forces), moments=pair(reference.moments), multiplier=pair(reference.multiplier),
            torque_multiplier=pair(reference.torque_multiplier), hessian_condition=reference.hessian_condition,
        )  # fmt: skip
        errors = judge(problem)
        if not max(errors) < WITHIN:
            raise ValueError(f"{problem.name}: {errors}")
        return problem
    certificate = problem.certificate
    if not certificate.any():
        certificate = pair(suite_references.certificate(problem, suite_references.escape_twist(problem)))
    problem = problem._replace(
        certificate=certificate, forces=np.zeros((2, n, 3)), moments=np.zeros((2, n)),
        torque_multiplier=np.zeros((2, joints)),
    )  # fmt: skip
    if not proves(problem):
        raise ValueError(f"{problem.name}: the certificate proves nothing")
    return problem


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=FILE, help="the file to write")
    parser.add_argument("--only", nargs="+", default=[], help="kinds to try, without writing")
    options = parser.parse_args()
    solved, errors = [], []
    for problem in suite_problems.draw():
        if options.only and problem.kind not in options.only:
            continue
        try:
            solved.append(with_reference(problem))
        except (ValueError, suite_references.NotDecidedError) as error:
            errors.append(f"{problem.name}: {error}")
            print(errors[-1], flush=True)
    print(f"{len(solved)} problems", flush=True)
    if errors and not options.only:
        raise SystemExit(f"{len(errors)} problems have no reference: nothing is written")
    if not options.only:
        write_npz(options.out, solved)


if __name__ == "__main__":
    main()
