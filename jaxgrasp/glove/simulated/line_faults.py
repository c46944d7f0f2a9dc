"""Reproducible fault injection for the bytes of a line."""

import random


class FaultInjector:
    """Fault injector for a share of the pieces: flipped bits, lost or inserted bytes, bursts, whole losses."""

    def __init__(self, share: float, seed: int) -> None:
        """Create a fault injector.

        Args:
            share: of the pieces that pass, how many get one fault.
            seed: of what happens to them.

        Raises:
            ValueError: for a share that is none.
        """
        if not 0 <= share <= 1:
            raise ValueError(f"share is {share}: expected 0 to 1")
        self.faults = 0
        """Number of spoilt pieces."""
        self._share, self._rng = share, random.Random(seed)

    def inject(self, piece: bytes) -> bytes:
        """Return the piece, changed by one fault if it is drawn for one."""
        rng = self._rng
        if not piece or rng.random() >= self._share:
            return piece
        self.faults += 1
        out, position = bytearray(piece), rng.randrange(len(piece))
        match rng.randrange(6):
            case 0:
                out[position] ^= 1 << rng.randrange(8)
            case 1:
                del out[position]
            case 2:
                out[position:position] = rng.randbytes(rng.randrange(1, 20))
            case 3:
                out[position : position + 8] = rng.randbytes(min(8, len(out) - position))
            case 4:
                out[:0] = rng.randbytes(rng.randrange(1, 60))
            case _:
                out.clear()
        return bytes(out)
