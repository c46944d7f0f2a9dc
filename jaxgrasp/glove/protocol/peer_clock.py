"""Another side's clock, from the frames that carry it and what they answer: how old is what it says?"""

import math
from collections import deque

import numpy as np

from jaxgrasp.glove.protocol.frames import TICKS

DRIFT = 6e-3
"""By how much two clocks may run apart, with room: half a per cent, as ceramic resonators do [1]."""
WINDOW = 0.25
"""Time of which the frame that came soonest counts [s]."""
FEWEST, KEPT = 4, 32
"""Windows from which a rate is known, and those that it is fitted to."""
SLACK = 1e-3
"""By how much a round trip may exceed the shortest without saying that something waits [s]."""
RELAXES = 1e-5
"""By how much the shortest round trip is let go [s/s]: a delay that grows more slowly is taken for the clock's rate."""


class PeerClock:
    """Times of another side's clock on ours.

    No frame arrives before it is sent: the least difference seen between arrival and its clock is the offset, and what
    a frame is later than that it has waited somewhere. Clocks that run apart and a delay that grows look alike in that
    difference, but not in the round trip, which a clock does not lengthen. So rate and offset are fitted to frames of
    short round trips alone, and go on by their rate while there are none.
    """

    def __init__(self, least: float = 0.0) -> None:
        """A clock of which nothing is known.

        Args:
            least: time that a frame takes at least, on an empty line [s].
        """
        self._least = least
        self._ticks: int | None = None
        self._unwrapped = 0
        self._offset, self._rate, self._seen = 0.0, 0.0, 0.0
        self._anchors: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._shortest = math.inf
        self._began = self._ends = 0.0
        self._soonest, self._trip = (math.inf, 0.0, 0.0), math.inf

    def sent_at(self, ticks: int, arrived: float, trip: float = 0.0) -> float:
        """When a frame was sent, on our clock [s].

        Args:
            ticks: its clock [us], modulo 2^32.
            arrived: when it came [s].
            trip: how long ago the frame of ours was sent that it answers [s].
        """
        if self._ticks is None:
            self._unwrapped = ticks
            self._offset = arrived - ticks * 1e-6
            self._open_window(ticks * 1e-6)
        else:
            # A late frame's clock is before the last one's.
            self._unwrapped += (ticks - self._ticks + TICKS // 2) % TICKS - TICKS // 2
        at = self._unwrapped * 1e-6
        lag = arrived - at
        if at >= self._ends:
            self._close_window(at)
        self._go_on(at, lag, arrived)
        self._soonest = min(self._soonest, (lag - self._rate * at, at, lag))
        self._trip = min(self._trip, trip)
        self._ticks, self._seen = ticks, arrived
        return at + self._expected(at) - self._least

    def _expected(self, at: float) -> float:
        """The least lag that a frame of a time may have."""
        return self._offset + self._rate * at

    def _go_on(self, at: float, lag: float, arrived: float) -> None:
        if len(self._anchors) < FEWEST:
            # Nothing is known of its rate: the offset is let go as fast as clocks may run apart.
            self._offset += DRIFT * max(arrived - self._seen, 0.0) if self._ticks is not None else 0.0
        self._offset = min(self._offset, lag - self._rate * at)

    def _open_window(self, at: float) -> None:
        self._began, self._ends = at, at + WINDOW
        self._soonest, self._trip = (math.inf, at, 0.0), math.inf

    def _close_window(self, at: float) -> None:
        self._shortest = min(self._shortest + RELAXES * (at - self._began), self._trip)
        if self._trip <= self._shortest + SLACK:
            self._anchors.append(self._soonest[1:])
            if len(self._anchors) >= FEWEST:
                self._fit()
        self._open_window(at)

    def _fit(self) -> None:
        times, lags = np.array(self._anchors).T
        middle = times.mean()
        apart = times - middle
        rate = float(apart @ (lags - lags.mean()) / (apart @ apart))
        self._rate = min(max(rate, -DRIFT), DRIFT)
        self._offset = float(np.min(lags - self._rate * times))


class RoundTrip:
    """How long it takes until frames come that answer ours: the least of the last moments.

    The least, since a busy program reads late what came in time.
    """

    def __init__(self, lasts: float = 0.1) -> None:
        """One that has seen nothing; ``lasts`` is how long a frame counts [s]."""
        self._lasts = lasts
        self._seen: deque[tuple[float, float]] = deque()

    def add(self, now: float, trip: float) -> None:
        """A frame came, that answers one of ours that was sent a time ago [s]."""
        while self._seen and self._seen[-1][1] >= trip:
            self._seen.pop()
        self._seen.append((now, trip))

    def least(self, now: float) -> float:
        """The least of the last moments [s]; infinite where nothing came."""
        while self._seen and self._seen[0][0] < now - self._lasts:
            self._seen.popleft()
        return self._seen[0][1] if self._seen else math.inf
