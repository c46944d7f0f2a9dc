"""Archives of columns are read in pieces: memory does not grow as they do."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from tests.batch.conftest import make_sets

pytestmark = pytest.mark.slow
MEASURED = """
import resource, sys
from jaxgrasp.cli.main import main
assert main(["evaluate", sys.argv[1], "--out", sys.argv[2], *sys.argv[3:]]) == 0
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
OPTIONS = ["--methods", "B", "--chunk", "4096", "--table", "none", "--no-report"]

TIMES = 20, 60
"""Of 10,000 grasps: both files have more than the chunks that are at work."""


def repeated(times: int) -> ContactSets:
    block = make_sets([5] * 10_000)
    columns = {name: np.tile(array, (times, *[1] * (array.ndim - 1))) for name, array in block.columns.items()}
    return ContactSets(
        **columns, offsets=np.arange(10_000 * times + 1) * 5, wrench=np.tile(block.wrench, (times, 1, 1))
    )


def most_memory(file: Path) -> int:
    """Return the peak memory of an evaluation in a process of its own [bytes]."""
    command = [sys.executable, "-c", MEASURED, str(file), f"{file}-results", *OPTIONS]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return int(done.stdout.splitlines()[-1]) << 10


@pytest.mark.parametrize("ending", ["npz", "h5", "parquet"])
def test_memory_does_not_grow_as_the_file_does(folder, ending):
    pytest.importorskip({"npz": "numpy", "h5": "h5py", "parquet": "pyarrow"}[ending])
    files = [folder / f"{times}.{ending}" for times in TIMES]
    for file, times in zip(files, TIMES, strict=True):
        jaxgrasp.save_grasps(file, repeated(times))
    small, large = (most_memory(file) for file in files)
    grown = files[1].stat().st_size - files[0].stat().st_size
    assert grown > 100 << 20 and large - small < grown / 3, (small, large, grown)
