"""Import of h5py, which reads and writes HDF5; the extra ``mesh`` installs it."""

from typing import Any

from jaxgrasp.validation.optional_library import optional_library

MISSING = "HDF5 files need h5py: pip install 'jaxgrasp[mesh]'"


def hdf5_library() -> Any:
    """Import h5py and return the module.

    Raises:
        ImportError: if it is not installed; the message names the command that installs it.
    """
    return optional_library("h5py", missing=MISSING)
