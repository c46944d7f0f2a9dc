import pytest

from benchmarks.kernel_calls import Kernel, has_compiler

# Compiled in half the time of -O3.
QUICK = ("-O1", "-march=native")


@pytest.fixture(scope="session")
def kernel(tmp_path_factory) -> Kernel:
    """The C++ kernel, compiled once."""
    if not has_compiler():
        pytest.skip("g++ is not installed")
    return Kernel(tmp_path_factory.mktemp("kernel"), QUICK)
