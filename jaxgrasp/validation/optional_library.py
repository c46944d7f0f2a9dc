"""Import of optional libraries where they are used; the error of a missing library says how to install it."""

from importlib import import_module
from typing import Any


def optional_library(*modules: str, missing: str) -> Any:
    """Import all of these modules and return the first.

    Args:
        modules: by their full names.
        missing: message of the error if a module cannot be imported, with the command that installs it.

    Raises:
        ImportError: with this message.
    """
    try:
        library, *_ = [import_module(name) for name in modules]
    except ImportError:
        raise ImportError(missing) from None
    return library


MISSING = "HDF5 files need h5py: pip install 'jaxgrasp[mesh]'"


def hdf5_library() -> Any:
    """Import h5py and return the module.

    Raises:
        ImportError: if it is not installed; the message names the command that installs it.
    """
    return optional_library("h5py", missing=MISSING)
