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
