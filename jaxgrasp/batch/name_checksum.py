"""Checksum of names, independent of their order: it differs if names are lost or doubled."""

import numpy as np

MODULUS = 1 << 64
_STEP = 0x9E3779B97F4A7C15
_MIXERS = ((np.uint64(30), np.uint64(0xBF58476D1CE4E5B9)), (np.uint64(27), np.uint64(0x94D049BB133111EB)))
"""Shifts and factors of SplitMix64 (Steele, Lea & Flood 2014), which spreads each bit of a number over all of it."""


def names_checksum(names: np.ndarray) -> int:
    """Compute the sum, modulo 2^64, of a hash of each text ``(N,)``."""
    texts = np.ascontiguousarray(names.astype(str))
    if not len(texts) or not texts.dtype.itemsize:
        return len(texts)
    codes = texts.view(np.uint32).reshape(len(texts), -1)
    numbers = np.full(len(texts), _STEP, np.uint64)
    for position, column in enumerate(codes.T):
        # A text is followed by zeros up to the longest one's length: these must not count.
        mixed = _mixed(column.astype(np.uint64) + np.uint64((position + 1) * _STEP % MODULUS))
        numbers += np.where(column, mixed, np.uint64(0))
    return int(np.sum(_mixed(numbers), dtype=np.uint64))


def _mixed(numbers: np.ndarray) -> np.ndarray:
    for shift, factor in _MIXERS:
        numbers = (numbers ^ (numbers >> shift)) * factor
    return numbers ^ (numbers >> np.uint64(31))
