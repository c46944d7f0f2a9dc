"""Pickled NumPy files that data sets come in, read without running anything that is in them.

A pickle is a program. This reader knows how NumPy spells arrays, their kinds and their numbers, and nothing else: what
asks for anything more is refused by its name, before it is made.
"""

import pickle
from pathlib import Path
from typing import IO, Any

import numpy as np

MOST_BYTES = 2**31
"""Larger files are refused: they are no lists of grasps."""
KINDS = "fiubSUO"
_ARRAY = object()
"""Stands for NumPy's class of arrays, which nothing may call."""


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        places = {"numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric"}
        known = {"ndarray": _ARRAY, "dtype": _kind, "_reconstruct": _empty, "scalar": _scalar}
        if module in places and name in known:
            return known[name]
        if (module, name) == ("_codecs", "encode"):
            return _bytes
        raise ValueError(f"it asks for {module}.{name}: expected arrays, numbers, text, lists and dictionaries alone")

    def persistent_load(self, pid: Any) -> Any:
        raise ValueError("it refers to something outside of itself")


def load_plain(path: str | Path) -> Any:
    """What a ``.npy`` file of pickled objects holds: its one object, or the array of them.

    Raises:
        ValueError: for a file that is no such, is too large, or asks for more than NumPy's arrays.
        OSError: for a file that cannot be read.
    """
    path = Path(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes: expected {MOST_BYTES} at most")
    try:
        with open(path, "rb") as stream:
            _check_header(stream)
            found = _PlainUnpickler(stream).load()
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, IndexError, KeyError) as error:
        raise ValueError(f"{path} is no plain file of NumPy's: {error}") from None
    except (MemoryError, OverflowError, RecursionError):
        raise ValueError(f"{path} is no plain file of NumPy's: it asks for too much") from None
    return found.item() if isinstance(found, np.ndarray) and found.shape == () else found


def _check_header(stream: IO[bytes]) -> None:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    _, _, kind = read(stream)
    if kind.kind != "O":
        raise ValueError(f"it holds {kind}: expected pickled objects")


def _empty(*_: Any) -> np.ndarray:
    """An array whose state comes next, which says its shape; whatever shape was asked for first."""
    return np.ndarray((0,), "b")


def _kind(spelled: Any, *rest: Any) -> np.dtype:
    found = np.dtype(spelled, *rest)
    if found.kind not in KINDS or found.names is not None:
        raise ValueError(f"it holds {found}: expected numbers and text")
    return found


def _scalar(kind: np.dtype, raw: Any = b"") -> Any:
    if not isinstance(kind, np.dtype) or kind.kind not in "fiub" or not isinstance(raw, bytes | str):
        raise ValueError("it holds a number of an unknown kind")
    return np.frombuffer(raw.encode("latin1") if isinstance(raw, str) else raw, kind, 1)[0]


def _bytes(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise ValueError("it holds text in an unknown encoding")
    return text.encode("latin1")
