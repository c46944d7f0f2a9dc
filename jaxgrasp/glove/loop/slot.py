"""Slot for the latest value in memory that processes share: no queue, no partial value."""

import mmap
import struct
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import Float

_HEAD = struct.Struct("<QI")
MAX_TRIES = 20


class Slot:
    """Array that one process writes and others read, in a memory-mapped file.

    A value is whole or not seen: it travels with its number and a check sum, whatever the order in which a processor
    lets another see what it writes.
    """

    def __init__(self, path: Path, size: int, *, create: bool = False) -> None:
        """Open a slot for ``size`` numbers.

        Args:
            path: the file, on the same machine for all.
            size: how many numbers.
            create: make the file, empty; the others need it to be there.

        Raises:
            OSError: without the file, or the right to it.
            ValueError: for a file of another size.
        """
        length = _HEAD.size + 8 * size
        if create:
            path.write_bytes(b"\0" * length)
        with open(path, "r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        if len(self._memory) != length:
            raise ValueError(f"{path} has {len(self._memory)} bytes: expected {length}")
        self._size, self._number = size, _HEAD.unpack_from(self._memory)[0]
        self._latest: tuple[int, np.ndarray] | None = None

    def write(self, values: Float[np.ndarray, "size"]) -> None:
        """Replace the value, of shape ``(size,)``."""
        self._number += 1
        raw = values.tobytes()
        # The number is no part of what could be right by chance: an old one fails with new numbers.
        checksum = zlib.crc32(raw, self._number % 2**32)
        self._memory[_HEAD.size :] = raw
        self._memory[: _HEAD.size] = _HEAD.pack(self._number, checksum)

    def read(self) -> Float[np.ndarray, "size"] | None:
        """Return the latest complete value, of shape ``(size,)``; None before the first."""
        for _ in range(MAX_TRIES):
            number, checksum = _HEAD.unpack_from(self._memory)
            if number == 0 or (self._latest is not None and number == self._latest[0]):
                break
            raw = self._memory[_HEAD.size :]
            if zlib.crc32(raw, number % 2**32) == checksum:
                self._latest = number, np.frombuffer(raw, np.float64)
                break
        return None if self._latest is None else self._latest[1]

    def close(self) -> None:
        """Unmap the shared memory."""
        self._memory.close()
