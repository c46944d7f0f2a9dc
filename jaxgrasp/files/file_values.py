"""Values in files of unknown origin: numbers as text or out of JSON, and TOML tables as dataclasses.

Errors name keys that are unknown, missing or of another kind.
"""

import difflib
import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import MISSING, fields
from enum import StrEnum
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from jaxgrasp.files.printable import shortened

HUGE = 1e300
"""Upper limit of every quantity; whole numbers far above it do not fit into a float."""
NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.IGNORECASE)
"""Pattern of a number; Python's own reading would take 1_0 for ten, and digits of every script."""


def decimal_number(text: str) -> float:
    """Convert text to a number; spaces and tabs around it do not count.

    Raises:
        ValueError: if the text is not a number; the message begins with "is", to follow the name of the place.
    """
    if not NUMBER.fullmatch(text.strip(" \t")):
        raise ValueError(f"is {shortened(text)}: expected a number")
    return float(text)


def is_number(value: Any, below: float = HUGE) -> bool:
    """Check that a value is an int or a float of size below ``below``; bools and NaN are rejected."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < below


DataclassT = TypeVar("DataclassT")


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file and return its top-level table.

    Raises:
        ValueError: for a file that is not TOML.
        OSError: for a file that cannot be read.
    """
    try:
        with open(path, "rb") as stream:
            return tomllib.load(stream)
    except RecursionError:
        raise ValueError(f"{path} is no TOML of ours: its tables or lists are nested too deeply") from None
    except ValueError as error:
        # Of the grammar, of the encoding, or of a number with thousands of digits.
        raise ValueError(f"{path} is no TOML: {error}") from None


def nearest(name: str, candidates: Sequence[str]) -> str:
    """Return the end of a message on an unknown name: the closest of the ``candidates``, or all of them."""
    matches = difflib.get_close_matches(name, candidates, 1, 0.5)
    return f": did you mean {matches[0]!r}?" if matches else f": expected one of {', '.join(candidates)}"


def build_dataclass(class_: type[DataclassT], table: Any, where: str) -> DataclassT:
    """Build a dataclass of numbers, texts, flags, literals, and tuples and tables of these, from a table of its fields.

    Args:
        class_: the dataclass.
        table: of the file.
        where: name of the table, for messages.

    Raises:
        ValueError: for keys that are unknown or missing, values of another kind, and whatever the dataclass refuses.
    """
    if not isinstance(table, dict):
        raise ValueError(f"{where} is {table!r}: expected a table")
    definitions = {definition.name: definition for definition in fields(class_) if definition.init}  # type: ignore[arg-type]
    for key in table:
        if key not in definitions:
            raise ValueError(f"{where} has {key!r}{nearest(key, list(definitions))}")
    for name, definition in definitions.items():
        if name not in table and definition.default is MISSING and definition.default_factory is MISSING:
            raise ValueError(f"{where} has no {name!r}")
    hints = get_type_hints(class_)
    values = {key: _value(f"{where}.{key}", value, hints[key]) for key, value in table.items()}
    try:
        return class_(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def number(name: str, value: Any) -> float:
    """Convert a value to a float, NaN included; raise a ValueError that names it if it is not a number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > HUGE:
        raise ValueError(f"{name} is {shortened(value)}: expected a number")
    return float(value)


def _value(name: str, value: Any, hint: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        if value not in arguments:
            raise ValueError(f"{name} is {value!r}{nearest(str(value), [str(choice) for choice in arguments])}")
        return value
    if origin is tuple:
        if not isinstance(value, list):
            raise ValueError(f"{name} is {value!r}: expected a list")
        return tuple(_value(f"{name}[{k}]", element, arguments[0]) for k, element in enumerate(value))
    if origin is dict:
        if not isinstance(value, dict):
            raise ValueError(f"{name} is {value!r}: expected a table")
        return {key: _value(f"{name}.{key}", element, arguments[1]) for key, element in value.items()}
    if origin in (Union, UnionType):
        return _value(name, value, next(option for option in arguments if option is not type(None)))
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        if value not in list(hint):
            raise ValueError(f"{name} is {value!r}{nearest(str(value), list(hint))}")
        return hint(value)
    if hint is float:
        if math.isnan(parsed := number(name, value)):
            raise ValueError(f"{name} is nan: expected a number")
        return parsed
    if hint is int and (isinstance(value, bool) or not isinstance(value, int)):
        raise ValueError(f"{name} is {value!r}: expected a whole number")
    if hint in (bool, str) and not isinstance(value, hint):
        raise ValueError(f"{name} is {value!r}: expected {'text' if hint is str else 'true or false'}")
    return value
