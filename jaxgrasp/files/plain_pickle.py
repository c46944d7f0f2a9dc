"""Reader of the pickled NumPy files of data sets, which runs no code of these files.

A pickle is a program. This reader knows how NumPy spells arrays, their kinds and their numbers, and nothing else: what
asks for anything more is refused by its name, before it is made. Nor does the program get hold of NumPy's own objects,
whose states it could set: arrays are plain records until it has ended, and are made of what these hold then.
"""

import math
import pickle
import re
import tokenize
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

MOST_BYTES = 2**31
"""Largest size of a file [bytes]; larger files are refused, since they cannot be lists of grasps."""
MOST_LEAVES = 50_000_000
"""Largest number of numbers and texts in lists, each counted as often as it occurs."""
DEEPEST = 100
"""Largest depth of lists within lists."""
SPELLED = re.compile(r"[<>=|]?[fiubSUO]\d{0,6}")


class _Kind:
    """A kind of numbers or text, as the file spells it."""

    __slots__ = ("order", "spelled")

    def __init__(self, spelled: Any, *_: Any) -> None:
        if not isinstance(spelled, str) or not SPELLED.fullmatch(spelled):
            raise ValueError(f"it holds {str(spelled)[:40]}: expected numbers and text")
        self.spelled, self.order = spelled.lstrip("<>=|"), "="

    def __setstate__(self, state: Any) -> None:
        """Set the byte order from a pickled state; refuse states that only structured types have."""
        if not (isinstance(state, tuple) and len(state) >= 5 and state[1] in ("<", ">", "|", "=") and state[3] is None):
            raise ValueError("it holds a kind of numbers that is none")
        self.order = state[1]

    def made(self) -> np.dtype:
        return np.dtype(self.spelled if self.order == "|" else self.order + self.spelled)


class _Array:
    """Record of a pickled array: its shape, kind, order of axes and raw data."""

    __slots__ = ("data", "fortran", "kind", "shape")

    def __init__(self) -> None:
        self.shape: tuple[int, ...] = (0,)
        self.kind, self.fortran, self.data = _Kind("b1"), False, b""

    def __setstate__(self, state: Any) -> None:
        if not (isinstance(state, tuple) and len(state) == 5):
            raise ValueError("it holds an array without a state")
        _, shape, kind, fortran, data = state
        sizes = isinstance(shape, tuple) and all(type(side) is int and 0 <= side < 2**40 for side in shape)
        if not (sizes and len(shape) <= 32 and isinstance(kind, _Kind)):
            raise ValueError("it holds an array of an unknown shape or kind")
        self.shape, self.kind, self.fortran, self.data = shape, kind, bool(fortran), data

    def made(self, plain: Callable[[Any], Any]) -> np.ndarray:
        """Build the array of this record; ``plain`` converts the elements of an object array."""
        count, kind = math.prod(self.shape), self.kind.made()
        order: Literal["C", "F"] = "F" if self.fortran else "C"
        if kind.kind == "O":
            if not isinstance(self.data, list) or len(self.data) != count:
                raise ValueError(f"it holds an array of shape {self.shape} with other than {count} objects")
            flat = np.empty(count, object)
            for k, one in enumerate(self.data):
                flat[k] = plain(one)
            return flat.reshape(self.shape, order=order)
        data = self.data.encode("latin1") if isinstance(self.data, str) else self.data
        if not isinstance(data, bytes) or len(data) != count * kind.itemsize:
            raise ValueError(f"it holds an array of shape {self.shape} and {kind} with other than as many bytes")
        return np.frombuffer(data, kind).reshape(self.shape, order=order).copy()


class _Call:
    """Wrapper of a function that a pickle may call; the pickle can neither set its state nor read its attributes."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *given: Any) -> Any:
        return self._call(*given)

    def __setstate__(self, _: Any) -> None:
        raise ValueError("it sets the state of what is none of its own")


def _scalar(kind: Any, raw: Any = b"") -> Any:
    if not isinstance(kind, _Kind) or kind.made().kind not in "fiub" or not isinstance(raw, bytes | str):
        raise ValueError("it holds a number of an unknown kind")
    return np.frombuffer(raw.encode("latin1") if isinstance(raw, str) else raw, kind.made(), 1)[0].item()


def _bytes(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise ValueError("it holds text in an unknown encoding")
    return text.encode("latin1")


def _no_array(*_: Any) -> Any:
    raise ValueError("it makes an array by another way than NumPy's own")


KNOWN = {
    "ndarray": _Call(_no_array),
    "dtype": _Call(_Kind),
    "_reconstruct": _Call(lambda *_: _Array()),
    "scalar": _Call(_scalar),
}
PLACES = {"numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric"}
ENCODE = _Call(_bytes)


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module in PLACES and name in KNOWN:
            return KNOWN[name]
        if (module, name) == ("_codecs", "encode"):
            return ENCODE
        raise ValueError(f"it asks for {module}.{name}: expected arrays, numbers, text, lists and dictionaries alone")

    def persistent_load(self, pid: Any) -> Any:
        raise ValueError("it refers to something outside of itself")


class _Plain:
    """Converter of loaded objects, which replaces records by arrays and converts an object that is shared only once."""

    def __init__(self) -> None:
        self._made: dict[int, tuple[Any, int]] = {}
        self._inside: set[int] = set()

    def of(self, loaded: Any) -> Any:
        return self._counted(loaded)[0]

    def _counted(self, loaded: Any) -> tuple[Any, int]:
        """Convert a loaded object; return the result and the number of numbers and texts in it."""
        if not isinstance(loaded, dict | list | tuple | _Array):
            if isinstance(loaded, _Kind | _Call):
                raise ValueError("it holds what is neither a number nor text")
            return loaded, 1
        key = id(loaded)
        if key in self._made:
            return self._made[key]
        if key in self._inside or len(self._inside) > DEEPEST:
            raise ValueError("it holds itself, or is nested too deeply")
        self._inside.add(key)
        made, count = self._inner(loaded)
        self._inside.discard(key)
        if count > MOST_LEAVES:
            raise ValueError(f"it holds more than {MOST_LEAVES:,} numbers in lists")
        self._made[key] = made, count
        return made, count

    def _inner(self, loaded: Any) -> tuple[Any, int]:
        counts = [1]

        def plain(one: Any) -> Any:
            found, count = self._counted(one)
            counts.append(count)
            return found

        if isinstance(loaded, _Array):
            return loaded.made(plain), sum(counts)
        if isinstance(loaded, dict):
            if not all(isinstance(name, str | bytes | int | float | None) for name in loaded):
                raise ValueError("it holds a dictionary of other than names")
            return {name: plain(one) for name, one in loaded.items()}, sum(counts)
        return type(loaded)(map(plain, loaded)), sum(counts)


def load_plain(path: str | Path) -> Any:
    """Read a ``.npy`` file of pickled objects; return its single object, or the array of objects.

    Raises:
        ValueError: for a file of another kind or too large a size, or a pickle that needs more than NumPy's arrays.
        OSError: for a file that cannot be read.
    """
    path = Path(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes: expected {MOST_BYTES} at most")
    try:
        with open(path, "rb") as stream:
            _check_header(stream)
            found = _Plain().of(_PlainUnpickler(stream).load())
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, IndexError, KeyError) as error:
        raise ValueError(f"{path} is no plain file of NumPy's: {error}") from None
    except (MemoryError, OverflowError, RecursionError):
        raise ValueError(f"{path} is no plain file of NumPy's: it asks for too much") from None
    return found.item() if isinstance(found, np.ndarray) and found.shape == () else found


def _check_header(stream: IO[bytes]) -> None:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    try:
        _, _, kind = read(stream)
    except (SyntaxError, tokenize.TokenError) as error:  # NumPy reads a header by Python's own tokenizer
        raise ValueError(f"its header cannot be read ({error})") from None
    if kind.kind != "O":
        raise ValueError(f"it holds {kind}: expected pickled objects")
