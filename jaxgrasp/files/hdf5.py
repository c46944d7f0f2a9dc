"""h5py, which reads and writes HDF5; the extra ``mesh`` brings it."""

from typing import Any

MISSING = "HDF5 files need h5py: pip install 'jaxgrasp[mesh]'"


def hdf5_library() -> Any:
    """h5py.

    Raises:
        ImportError: where it is not installed, with the command that does it.
    """
    try:
        import h5py
    except ImportError:
        raise ImportError(MISSING) from None
    return h5py
