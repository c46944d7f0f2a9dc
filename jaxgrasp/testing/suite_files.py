"""Files of the suite: its own .npz, Conic Benchmark Format for conic solvers, and pyramids as QPs of qpbenchmark."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.testing.suite_problem import VERSION, SuiteProblem
from jaxgrasp.testing.suite_program import Program, check_sides, conic_program, pyramid_program

CONTACT_FIELDS = ("points", "normals", "friction", "squeeze", "weights")
PAIRS = ("forces", "moments")
"""Pairs of float64 for each contact."""


def write_npz(path: Path, problems: Sequence[SuiteProblem]) -> None:
    """Write problems with their references as plain arrays: those of contacts end to end, cut by ``offsets``.

    A NaN in ``torsion`` stands for problems of hard fingers; joints, end to end too, are cut by ``joint_offsets``.
    """
    sizes = [len(problem.friction) for problem in problems]
    joints = [0 if problem.torque_max is None else len(problem.torque_max) for problem in problems]
    arrays: dict[str, Any] = {
        "version": np.array(VERSION),
        "name": np.array([problem.name for problem in problems]),
        "kind": np.array([problem.kind for problem in problems]),
        "offsets": np.cumsum([0, *sizes]),
        "joint_offsets": np.cumsum([0, *joints]),
        "feasible": np.array([problem.feasible for problem in problems]),
        "wrench": np.stack([problem.wrench for problem in problems]),
        "multiplier": np.stack([problem.multiplier for problem in problems]),
        "certificate": np.stack([problem.certificate for problem in problems]),
    }
    for name in ("grasp_condition", "hessian_condition", "distance"):
        arrays[name] = np.array([getattr(problem, name) for problem in problems])
    for name in CONTACT_FIELDS:
        arrays[name] = np.concatenate([getattr(problem, name) for problem in problems])
    arrays["torsion"] = np.concatenate(
        [np.full(n, np.nan) if p.torsion is None else p.torsion for n, p in zip(sizes, problems, strict=True)]
    )
    for name in PAIRS:
        arrays[name] = np.concatenate([getattr(problem, name) for problem in problems], 1)
    torque_maps = [problem.torque_map.ravel() for problem in problems if problem.torque_map is not None]
    arrays["torque_map"] = np.concatenate([np.zeros(0), *torque_maps])
    bounds = [problem.torque_max for problem in problems if problem.torque_max is not None]
    arrays["torque_max"] = np.concatenate([np.zeros(0), *bounds])
    arrays["torque_multiplier"] = np.concatenate([np.zeros((2, 0)), *(p.torque_multiplier for p in problems)], 1)
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)


def read_npz(path: Path) -> Iterable[SuiteProblem]:
    """Yield the problems of a file that ``write_npz`` wrote.

    Raises:
        ValueError: for a file of another version.
    """
    with np.load(path) as archive:
        arrays = dict(archive)
    if str(arrays["version"]) != VERSION:
        raise ValueError(f"{path}: version is {arrays['version']}: expected {VERSION}")
    first_entry = 0
    for i, name in enumerate(arrays["name"]):
        rows = slice(*arrays["offsets"][i : i + 2])
        columns = slice(*arrays["joint_offsets"][i : i + 2])
        n, joints = rows.stop - rows.start, columns.stop - columns.start
        fields: dict[str, Any] = {field: arrays[field][rows] for field in CONTACT_FIELDS}
        fields |= {field: arrays[field][:, rows] for field in PAIRS}
        fields |= {field: arrays[field][i] for field in ("wrench", "multiplier", "certificate")}
        fields |= {field: float(arrays[field][i]) for field in ("grasp_condition", "hessian_condition", "distance")}
        if not np.isnan(arrays["torsion"][rows]).any():
            fields["torsion"] = arrays["torsion"][rows]
        if joints:
            entries = slice(first_entry, first_entry + 3 * n * joints)
            fields["torque_map"] = arrays["torque_map"][entries].reshape(n, 3, joints)
            fields["torque_max"] = arrays["torque_max"][columns]
            fields["torque_multiplier"] = arrays["torque_multiplier"][:, columns]
            first_entry = entries.stop
        yield SuiteProblem(str(name), str(arrays["kind"][i]), feasible=bool(arrays["feasible"][i]), **fields)


def write_cbf(folder: Path, problems: Iterable[SuiteProblem], *, is_scaled: bool = False) -> None:
    """Write one file of the Conic Benchmark Format (version 3) for each problem, and ``index.csv`` with the answers.

    The quadratic objective becomes a linear one: minimise t with (t + 1/2, t - 1/2, sqrt(2) F x) in a second-order
    cone, that is t >= |F x|^2, F x being the deviations from the squeezing forces over sqrt(2 k). So the objective is
    the suite's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["name,kind,contacts,feasible,objective,grasp_condition,hessian_condition,distance"]
    for problem in problems:
        program = conic_program(problem, is_scaled=is_scaled)
        (folder / f"{problem.name}.cbf").write_text(cbf_text(problem, program))
        value = program.objective(problem) if problem.feasible else np.nan
        lines.append(
            f"{problem.name},{problem.kind},{len(problem.friction)},{int(problem.feasible)},{value!r},"
            f"{problem.grasp_condition!r},{problem.hessian_condition!r},{problem.distance!r}"
        )
    (folder / "index.csv").write_text("\n".join(lines) + "\n")


def cbf_text(problem: SuiteProblem, program: Program) -> str:
    """Return the text of a problem in the Conic Benchmark Format.

    CBF's constraints are A x + b in a cone, and ours A x + slack = b with the slack in a cone: rows change their sign.
    """
    size = program.matrix.shape[1]
    rows, right = -program.matrix.toarray(), np.array(program.bound)
    cones = [("L=", program.n_zero), ("L+", program.n_nonnegative), *(("Q", dim) for dim in program.cone_sizes)]
    # t + 1/2 >= |(t - 1/2, sqrt(2) F x + sqrt(2) c)|, by which t >= |F x + c|^2.
    root, shift = program.cost_root()
    epigraph = np.zeros((2 + size, size + 1))
    epigraph[0, size] = epigraph[1, size] = 1.0
    epigraph[2:, :size] = np.sqrt(2.0) * root
    rows = np.concatenate([np.pad(rows, [(0, 0), (0, 1)]), epigraph])
    right = np.concatenate([right, [0.5, -0.5], np.sqrt(2.0) * shift])
    cones = [(name, count) for name, count in [*cones, ("Q", 2 + size)] if count]
    entries = [(i, j, rows[i, j]) for i, j in zip(*np.nonzero(rows), strict=True)]
    bounds = [(i, right[i]) for i in np.flatnonzero(right)]
    answer = f"objective {program.objective(problem)!r}" if problem.feasible else "infeasible"
    lines = [
        f"# {problem.name} of the grasp suite of jaxgrasp, version {VERSION}: {answer}",
        *("VER", "3", "", "OBJSENSE", "MIN", "", "VAR", f"{size + 1} 1", f"F {size + 1}", ""),
        *("CON", f"{len(rows)} {len(cones)}", *(f"{name} {count}" for name, count in cones), ""),
        *("OBJACOORD", "1", f"{size} 1.0", ""),
        *("ACOORD", str(len(entries)), *(f"{i} {j} {float(value)!r}" for i, j, value in entries), ""),
        *("BCOORD", str(len(bounds)), *(f"{i} {float(value)!r}" for i, value in bounds), ""),
    ]
    return "\n".join(lines)


def write_qps(folder: Path, problems: Iterable[SuiteProblem], *, sides: int = 8, is_scaled: bool = False) -> list[str]:
    """Write one .npz for each problem in the layout of qpbenchmark: P, q, G, h, A, b, lb, ub of ``qpsolvers.Problem``.

    Friction cones become inscribed pyramids: minimise x'Px / 2 + q'x subject to G x <= h, A x = b. An infeasible
    problem stays so; a feasible one may become infeasible. Problems of soft fingers, whose cones have four dimensions,
    are left out.

    Returns:
        The names of those left out.

    Raises:
        ValueError: for fewer than 3 sides.
    """
    check_sides(sides)
    folder.mkdir(parents=True, exist_ok=True)
    left_out = []
    for problem in problems:
        if problem.torsion is not None:
            left_out.append(problem.name)
            continue
        program = pyramid_program(problem, sides=sides, is_scaled=is_scaled)
        # An array of None is how qpsolvers writes what a problem does not have.
        nothing = np.array(None)
        path = folder / f"{problem.name}.npz"
        with open(path, "wb") as file:
            np.savez(
                file,
                P=program.quadratic.toarray(),
                q=program.linear,
                G=program.matrix.toarray()[program.n_zero :],
                h=program.bound[program.n_zero :],
                A=program.matrix.toarray()[: program.n_zero],
                b=program.bound[: program.n_zero],
                lb=nothing,
                ub=nothing,
                name=np.array(problem.name),
            )
    return left_out
