"""Another side's clock, from the frames that carry it: how old is what it says?"""

from jaxgrasp.glove.protocol.frames import TICKS

DRIFT = 6e-3
"""By how much two clocks may run apart, with room: half a per cent, as ceramic resonators do [1]."""


class PeerClock:
    """Times of another side's clock on ours, from arrivals alone.

    No frame arrives before it is sent: the least difference seen between arrival and its clock is the offset, and what
    a frame is later than that it has waited somewhere. The least is let go at the rate of drifting clocks.
    """

    def __init__(self, least: float = 0.0) -> None:
        """A clock of which nothing is known.

        Args:
            least: time that a frame takes at least, on an empty line [s].
        """
        self._least = least
        self._ticks: int | None = None
        self._unwrapped = 0
        self._offset = self._seen = 0.0

    def sent_at(self, ticks: int, arrived: float) -> float:
        """When a frame was sent, on our clock [s].

        Args:
            ticks: its clock [us], modulo 2^32.
            arrived: when it came [s].
        """
        if self._ticks is None:
            self._offset = arrived - ticks * 1e-6
            self._unwrapped = ticks
        else:
            # A late frame's clock is before the last one's.
            self._unwrapped += (ticks - self._ticks + TICKS // 2) % TICKS - TICKS // 2
            allowed = self._offset + DRIFT * max(arrived - self._seen, 0.0)
            self._offset = min(allowed, arrived - self._unwrapped * 1e-6)
        self._ticks, self._seen = ticks, arrived
        return self._unwrapped * 1e-6 + self._offset - self._least
