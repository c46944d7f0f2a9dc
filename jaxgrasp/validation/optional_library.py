"""Libraries that an extra brings: loaded where they are used, and where one is not there, a line says how to get it."""

from importlib import import_module
from typing import Any


def optional_library(*modules: str, missing: str) -> Any:
    """The first of these modules, with all of them loaded.

    Args:
        modules: by their full names.
        missing: what is said where one of them cannot be imported, with the command that installs it.

    Raises:
        ImportError: with these words.
    """
    try:
        library, *_ = [import_module(name) for name in modules]
    except ImportError:
        raise ImportError(missing) from None
    return library
