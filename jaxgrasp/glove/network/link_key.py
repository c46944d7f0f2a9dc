"""Shared key of two hosts, from a file that others cannot read or from the environment; never from a command line."""

import os
import stat

VARIABLE = "JAXGRASP_GLOVE_KEY"
"""Environment variable of the key."""
MIN_BYTES, MAX_BYTES = 16, 64
"""Range of the number of bytes of a key."""
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_EXPECTED = f"expected {2 * MIN_BYTES} to {2 * MAX_BYTES} hexadecimal digits"


def load_key(path: str | os.PathLike | None = None) -> bytes:
    """Load the key from a file, or without a path from the environment's ``JAXGRASP_GLOVE_KEY``; empty if it is unset.

    A key does not belong on a command line, which every user of a machine can read.

    Raises:
        ValueError: for what is no key, and a file that others than its owner can read or write.
        OSError: for a file that cannot be read.
    """
    if path is None:
        text = os.environ.get(VARIABLE, "")
        return _key(VARIABLE, text) if text else b""
    with open(path, encoding="ascii", errors="replace") as file:
        if os.name == "posix" and stat.S_IMODE(os.fstat(file.fileno()).st_mode) & _OTHERS:
            raise ValueError(f"key file {path} can be read by others: restrict it to its owner (chmod 600 {path})")
        return _key(f"key file {path}", file.read(4 * MAX_BYTES).strip())


def _key(source: str, text: str) -> bytes:
    try:
        key = bytes.fromhex(text)
    except ValueError:
        raise ValueError(f"{source} is not hexadecimal: {_EXPECTED}") from None
    if not MIN_BYTES <= len(key) <= MAX_BYTES:
        raise ValueError(f"{source} holds {len(key)} bytes: {_EXPECTED}")
    return key
