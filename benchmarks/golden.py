"""Comparison of the answers of two versions to a thousand problems of every kind, for changes of structure alone.

    python -m benchmarks.golden COMMIT

Both versions answer on this machine, so that nothing differs but the code; the other is checked out from the
repository's history. Prints each field that differs, and ends with 1 where one differs by more than 1e-12 of the
problem's largest number in that field, or a verdict does.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.earlier import checked_out
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.limited_problems import limited_problems

FOLDER = Path(__file__).parent
SIZES = {4: 28, 12: 28}
"""How many problems of each of the 19 kinds, by contacts."""
JOINTS = 5
LARGEST = 1e-12


def problems() -> dict[str, np.ndarray]:
    """Return every kind's problems one after the other, by size."""
    data: dict[str, np.ndarray] = {}
    for n, count in SIZES.items():
        drawn = [limited_problems(kind, n, count, seed=8, soft=True, bounded=True, joints=JOINTS) for kind in P.KINDS]
        for name in ("points", "normals", "friction", "squeeze", "wrench"):
            data[f"{n} {name}"] = np.concatenate([getattr(kind_problems.problem, name) for kind_problems in drawn])
        for name in ("torsion", "normal_min", "normal_max", "torque_map", "torque_max"):
            data[f"{n} {name}"] = np.concatenate([getattr(kind_problems, name) for kind_problems in drawn])
        data[f"{n} direction"] = np.random.default_rng(n).normal(size=data[f"{n} wrench"].shape)
    return data


def answers(folder: Path, problem_file: Path, out: Path) -> dict[str, np.ndarray]:
    code = (FOLDER / "golden_answers.py").read_text()
    subprocess.run(
        [sys.executable, "-c", code, str(problem_file), str(out)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        check=True,
    )
    with np.load(out) as archive:
        return {name: archive[name] for name in archive.files}


def largest_difference(before: np.ndarray, after: np.ndarray) -> float:
    """Return the largest difference relative to its problem's largest number; infinite where only one is finite."""
    before, after = (x.reshape(len(x), -1).astype(float) for x in (before, after))
    both_finite = np.isfinite(before) & np.isfinite(after)
    if not np.array_equal(np.where(both_finite, 0, before), np.where(both_finite, 0, after), equal_nan=True):
        return np.inf
    largest = np.where(both_finite, np.abs(before), 0).max(1, keepdims=True)
    differs = np.abs(np.where(both_finite, before, 0) - np.where(both_finite, after, 0))
    return float(np.max(differs / np.where(largest > 0, largest, 1), initial=0.0))


def compare(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> bool:
    """Print what differs; whether all of it is within rounding."""
    unlike = sorted(before.keys() ^ after.keys())
    print(*(f"only in one version: {name}" for name in unlike), sep="\n", end="\n" if unlike else "")
    shared = [name for name in before if name in after]
    differences = {name: largest_difference(before[name], after[name]) for name in shared}
    for name, difference in differences.items():
        if difference:
            print(f"{name}: {difference:.1e}")
    n_equal = sum(difference == 0 for difference in differences.values())
    print(f"{n_equal} of {len(shared)} fields are equal to the bit; largest difference {max(differences.values()):.1e}")
    limits = {name: 0.0 if name.endswith("verdict") else LARGEST for name in shared}
    return not unlike and all(differences[name] <= limits[name] for name in shared)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", help="the version to compare with")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, checked_out(options.commit) as before:
        problem_file = Path(scratch) / "problems.npz"
        np.savez(problem_file, **problems())  # type: ignore[arg-type]
        old = answers(before, problem_file, Path(scratch) / "old.npz")
        new = answers(FOLDER.parent, problem_file, Path(scratch) / "new.npz")
    sys.exit(0 if compare(old, new) else 1)


if __name__ == "__main__":
    main()
