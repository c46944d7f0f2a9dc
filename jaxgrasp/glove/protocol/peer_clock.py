"""Estimate of the other side's clock from its frames and the frames that they answer, to know the age of data."""

import math
from collections import deque

import numpy as np

from jaxgrasp.glove.protocol.frames import TICKS

DRIFT = 6e-3
"""Largest relative drift of two clocks, with a margin: half a per cent, as for ceramic resonators [1]."""
WINDOW = 0.25
"""Length of a window, of which the frame with the least lag counts [s]."""
MIN_WINDOWS, MAX_WINDOWS = 4, 32
"""Smallest number of windows for a fit of the clock rate, and largest number of windows in the fit."""
SLACK = 1e-3
"""Largest excess of a round trip over the shortest that does not count as waiting [s]."""
RELAXATION = 1e-5
"""Rate at which the shortest round trip is relaxed [s/s]: a slower growth of delay is attributed to the clock."""


class PeerClock:
    """Conversion of the other side's clock to the local clock.

    No frame arrives before it is sent: the least difference seen between arrival and its clock is the offset, and what
    a frame is later than that it has waited somewhere. Clocks that run apart and a delay that grows look alike in that
    difference, but not in the round trip, which a clock does not lengthen. So rate and offset are fitted to frames of
    short round trips alone, and go on by their rate while there are none.
    """

    def __init__(self, min_transfer: float = 0.0) -> None:
        """Create a clock of which nothing is known.

        Args:
            min_transfer: time that a frame takes at least, on an empty line [s].
        """
        self._min_transfer = min_transfer
        self._ticks: int | None = None
        self._unwrapped = 0
        self._offset, self._rate, self._last_arrival = 0.0, 0.0, 0.0
        self._anchors: deque[tuple[float, float]] = deque(maxlen=MAX_WINDOWS)
        self._shortest = math.inf
        self._window_start = self._window_end = 0.0
        self._least_lag, self._trip = (math.inf, 0.0, 0.0), math.inf

    def sent_at(self, ticks: int, arrived: float, trip: float = 0.0) -> float:
        """Estimate the time at which a frame was sent, on the local clock [s].

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
        if at >= self._window_end:
            self._close_window(at)
        self._extrapolate(at, lag, arrived)
        self._least_lag = min(self._least_lag, (lag - self._rate * at, at, lag))
        self._trip = min(self._trip, trip)
        self._ticks, self._last_arrival = ticks, arrived
        return at + self._expected(at) - self._min_transfer

    def _expected(self, at: float) -> float:
        """Compute the least lag [s] of a frame sent at a time on the other side's clock [s]."""
        return self._offset + self._rate * at

    def _extrapolate(self, at: float, lag: float, arrived: float) -> None:
        if len(self._anchors) < MIN_WINDOWS:
            # Nothing is known of its rate: the offset is let go as fast as clocks may run apart.
            self._offset += DRIFT * max(arrived - self._last_arrival, 0.0) if self._ticks is not None else 0.0
        self._offset = min(self._offset, lag - self._rate * at)

    def _open_window(self, at: float) -> None:
        self._window_start, self._window_end = at, at + WINDOW
        self._least_lag, self._trip = (math.inf, at, 0.0), math.inf

    def _close_window(self, at: float) -> None:
        self._shortest = min(self._shortest + RELAXATION * (at - self._window_start), self._trip)
        if self._trip <= self._shortest + SLACK:
            self._anchors.append(self._least_lag[1:])
            if len(self._anchors) >= MIN_WINDOWS:
                self._fit()
        self._open_window(at)

    def _fit(self) -> None:
        times, lags = np.array(self._anchors).T
        mean_time = times.mean()
        centred = times - mean_time
        # Least squares: rate = cov(t, lag) / var(t); the offset puts all lags above the line.
        rate = float(centred @ (lags - lags.mean()) / (centred @ centred))
        self._rate = min(max(rate, -DRIFT), DRIFT)
        self._offset = float(np.min(lags - self._rate * times))


class RoundTrip:
    """Shortest recent round trip, from a local frame to the frame that answers it.

    The minimum counts, since a busy program reads frames late that came in time.
    """

    def __init__(self, duration: float = 0.1) -> None:
        """Create an estimator without frames; ``duration`` is the time for which a frame counts [s]."""
        self._duration = duration
        self._minima: deque[tuple[float, float]] = deque()

    def add(self, timestamp: float, trip: float) -> None:
        """Record the round trip [s] of a frame that came at a time [s]."""
        while self._minima and self._minima[-1][1] >= trip:
            self._minima.pop()
        self._minima.append((timestamp, trip))

    def shortest(self, timestamp: float) -> float:
        """Return the shortest recent round trip [s]; infinite if no frame came."""
        while self._minima and self._minima[0][0] < timestamp - self._duration:
            self._minima.popleft()
        return self._minima[0][1] if self._minima else math.inf
