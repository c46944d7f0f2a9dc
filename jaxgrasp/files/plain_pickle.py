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


class _Dtype:
    """Data type of numbers or text, as the file spells it."""

    __slots__ = ("order", "spelled")

    def __init__(self, spelled: Any, *_: Any) -> None:
        if not isinstance(spelled, str) or not SPELLED.fullmatch(spelled):
            raise ValueError(f"it holds {str(spelled)[:40]}: expected numbers and text")
        self.spelled, self.order = spelled.lstrip("<>=|"), "="

    def __setstate__(self, state: Any) -> None:
        """Set the byte order from a pickled state; refuse states that only structured types have."""
        if not (isinstance(state, tuple) and len(state) >= 5 and state[1] in ("<", ">", "|", "=") and state[3] is None):
            raise ValueError("it holds an unknown kind of numbers")
        self.order = state[1]

    def build(self) -> np.dtype:
        return np.dtype(self.spelled if self.order == "|" else self.order + self.spelled)


class _Array:
    """Record of a pickled array: its shape, data type, order of axes and raw data."""

    __slots__ = ("data", "dtype", "fortran", "shape")

    def __init__(self) -> None:
        self.shape: tuple[int, ...] = (0,)
        self.dtype, self.fortran, self.data = _Dtype("b1"), False, b""

    def __setstate__(self, state: Any) -> None:
        if not (isinstance(state, tuple) and len(state) == 5):
            raise ValueError("it holds an array without a state")
        _, shape, dtype, fortran, data = state
        sizes = isinstance(shape, tuple) and all(type(side) is int and 0 <= side < 2**40 for side in shape)
        if not (sizes and len(shape) <= 32 and isinstance(dtype, _Dtype)):
            raise ValueError("it holds an array of an unknown shape or kind")
        self.shape, self.dtype, self.fortran, self.data = shape, dtype, bool(fortran), data

    def build(self, plain: Callable[[Any], Any]) -> np.ndarray:
        """Build the array of this record; ``plain`` converts the elements of an object array."""
        count, dtype = math.prod(self.shape), self.dtype.build()
        order: Literal["C", "F"] = "F" if self.fortran else "C"
        if dtype.kind == "O":
            if not isinstance(self.data, list) or len(self.data) != count:
                raise ValueError(f"it holds an array of shape {self.shape} without exactly {count} objects")
            flat = np.empty(count, object)
            for k, element in enumerate(self.data):
                flat[k] = plain(element)
            return flat.reshape(self.shape, order=order)
        data = self.data.encode("latin1") if isinstance(self.data, str) else self.data
        if not isinstance(data, bytes) or len(data) != count * dtype.itemsize:
            raise ValueError(f"it holds an array of shape {self.shape} and {dtype} with another number of bytes")
        return np.frombuffer(data, dtype).reshape(self.shape, order=order).copy()


class _Call:
    """Wrapper of a function that a pickle may call; the pickle can neither set its state nor read its attributes."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)

    def __setstate__(self, _: Any) -> None:
        raise ValueError("it sets the state of an object that it may not change")


def _scalar(dtype: Any, raw: Any = b"") -> Any:
    if not isinstance(dtype, _Dtype) or dtype.build().kind not in "fiub" or not isinstance(raw, bytes | str):
        raise ValueError("it holds a number of an unknown kind")
    return np.frombuffer(raw.encode("latin1") if isinstance(raw, str) else raw, dtype.build(), 1)[0].item()


def _bytes(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise ValueError("it holds text in an unknown encoding")
    return text.encode("latin1")


def _no_array(*_: Any) -> Any:
    raise ValueError("it builds an array in another way than NumPy does")


ALLOWED = {
    "ndarray": _Call(_no_array),
    "dtype": _Call(_Dtype),
    "_reconstruct": _Call(lambda *_: _Array()),
    "scalar": _Call(_scalar),
}
PLACES = {"numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric"}
ENCODE = _Call(_bytes)


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module in PLACES and name in ALLOWED:
            return ALLOWED[name]
        if (module, name) == ("_codecs", "encode"):
            return ENCODE
        raise ValueError(f"it asks for {module}.{name}: expected arrays, numbers, text, lists and dictionaries alone")

    def persistent_load(self, pid: Any) -> Any:
        raise ValueError("it refers to something outside of itself")


class _Plain:
    """Converter of loaded objects, which replaces records by arrays and converts an object that is shared only once."""

    def __init__(self) -> None:
        self._converted: dict[int, tuple[Any, int]] = {}
        self._inside: set[int] = set()

    def of(self, loaded: Any) -> Any:
        return self._counted(loaded)[0]

    def _counted(self, loaded: Any) -> tuple[Any, int]:
        """Convert a loaded object; return the result and the number of numbers and texts in it."""
        if not isinstance(loaded, dict | list | tuple | _Array):
            if isinstance(loaded, _Dtype | _Call):
                raise ValueError("it holds an object that is neither a number nor text")
            return loaded, 1
        key = id(loaded)
        if key in self._converted:
            return self._converted[key]
        if key in self._inside or len(self._inside) > DEEPEST:
            raise ValueError("it holds itself, or is nested too deeply")
        self._inside.add(key)
        converted, count = self._inner(loaded)
        self._inside.discard(key)
        if count > MOST_LEAVES:
            raise ValueError(f"it holds more than {MOST_LEAVES:,} numbers in lists")
        self._converted[key] = converted, count
        return converted, count

    def _inner(self, loaded: Any) -> tuple[Any, int]:
        counts = [1]

        def plain(element: Any) -> Any:
            converted, count = self._counted(element)
            counts.append(count)
            return converted

        if isinstance(loaded, _Array):
            return loaded.build(plain), sum(counts)
        if isinstance(loaded, dict):
            if not all(isinstance(name, str | bytes | int | float | None) for name in loaded):
                raise ValueError("it holds a dictionary with keys that are not names")
            return {name: plain(element) for name, element in loaded.items()}, sum(counts)
        return type(loaded)(map(plain, loaded)), sum(counts)


def load_plain(path: str | Path) -> Any:
    """Read a ``.npy`` file of pickled objects; return its single object, or the array of objects.

    Raises:
        ValueError: for a file of another kind or too large a size, or a pickle that needs more than NumPy's arrays.
        OSError: for a file that cannot be read.
    """
    path = Path(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes: expected at most {MOST_BYTES}")
    try:
        with open(path, "rb") as stream:
            _check_header(stream)
            content = _Plain().of(_PlainUnpickler(stream).load())
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, IndexError, KeyError) as error:
        raise ValueError(f"{path} is not a plain NumPy file: {error}") from None
    except (MemoryError, OverflowError, RecursionError):
        raise ValueError(f"{path} is not a plain NumPy file: it asks for too much") from None
    return content.item() if isinstance(content, np.ndarray) and content.shape == () else content


def _check_header(stream: IO[bytes]) -> None:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    try:
        _, _, dtype = read(stream)
    except (SyntaxError, tokenize.TokenError) as error:  # NumPy reads a header by Python's own tokenizer
        raise ValueError(f"its header cannot be read ({error})") from None
    if dtype.kind != "O":
        raise ValueError(f"it holds {dtype}: expected pickled objects")
