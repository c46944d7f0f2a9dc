"""h5py, which reads and writes HDF5; the extra ``mesh`` brings it."""

from typing import Any

from jaxgrasp.validation.optional_library import optional_library

MISSING = "HDF5 files need h5py: pip install 'jaxgrasp[mesh]'"


def hdf5_library() -> Any:
    """h5py.

    Raises:
        ImportError: where it is not installed, with the command that does it.
    """
    return optional_library("h5py", missing=MISSING)
