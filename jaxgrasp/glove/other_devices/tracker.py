"""Tracker on a line, polled for each pose or streaming; it keeps the newest plausible sample."""

import math
from typing import Literal

import numpy as np

from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.other_devices.polhemus import (
    Decoder,
    FastrakAscii,
    FastrakBinary,
    IsotrakBinary,
    JumpFilter,
    TrackerSample,
)

Protocol = Literal["isotrak-binary", "fastrak-ascii", "fastrak-binary"]
PROTOCOLS: dict[str, tuple[type[Decoder], tuple[bytes, ...]]] = {
    "isotrak-binary": (IsotrakBinary, (b"O2,11\r", b"u", b"f")),
    "fastrak-ascii": (FastrakAscii, (b"O1,2,11,1\r", b"u", b"F")),
    "fastrak-binary": (FastrakBinary, (b"O1,2,11,0\r", b"u", b"f")),
}
"""Decoder and setup commands of each protocol: output list, metric units, ASCII (``F``) or binary (``f``)."""
STREAM, STOP, ASK = b"C", b"c", b"P"
RETRY_AFTER = 0.2
"""Time without an answer after which the tracker is asked again [s]."""


class Tracker:
    """Reader of the wrist's pose from a Polhemus tracker; no call waits."""

    def __init__(
        self,
        line: Line,
        protocol: Protocol,
        *,
        streams: bool = True,
        station: int = 1,
        jumps: JumpFilter | None = None,
    ) -> None:
        """Send the setup commands of the protocol to a tracker, which does not answer them.

        Args:
            line: an open port, at the baud rate that the tracker's switches say.
            protocol: which tracker and format; set to centimetres, metres come out.
            streams: whether it sends by itself, or is asked each time.
            station: of the receiver on the wrist.
            jumps: what refuses samples that no hand can make; the usual one if None.

        Raises:
            ValueError: for another protocol or station.
            LineError: if the line is gone.
        """
        if protocol not in PROTOCOLS:
            raise ValueError(f"protocol is {protocol!r}: expected {', '.join(PROTOCOLS)}")
        if not 1 <= station <= 4:
            raise ValueError(f"station is {station}: expected 1 to 4")
        decoder_type, setup_commands = PROTOCOLS[protocol]
        self.decoder = decoder_type()
        self.jumps = jumps or JumpFilter()
        self.sample: TrackerSample | None = None
        self.sampled_at = -math.inf
        """Arrival time of the sample [s]."""
        self._line, self._streams, self._station = line, streams, station
        self._asked_at, self._is_waiting = -math.inf, False
        line.write(STOP + b"".join(setup_commands) + (STREAM if streams else b""))

    def poll(self, timestamp: float) -> TrackerSample | None:
        """Decode the bytes that came and ask for the next sample if it does not stream; return the newest sample.

        Raises:
            LineError: if the line is gone.
        """
        for sample in self.decoder.feed(self._line.read()):
            self._is_waiting = False
            if sample.station == self._station and self.jumps.passes(timestamp, sample):
                self.sample, self.sampled_at = _continued(sample, self.sample), timestamp
        if not self._streams and (not self._is_waiting or timestamp - self._asked_at > RETRY_AFTER):
            self._is_waiting, self._asked_at = True, timestamp
            self._line.write(ASK)
        return self.sample

    def close(self) -> None:
        """Stop the stream, if the line is still there, and close it."""
        try:
            self._line.write(STOP)
        except LineError:
            self._is_waiting = False
        self._line.close()


def _continued(sample: TrackerSample, previous: TrackerSample | None) -> TrackerSample:
    """Choose the sign of a sample's quaternion that is nearer to the quaternion of the sample before."""
    if previous is None or np.dot(sample.quaternion, previous.quaternion) >= 0:
        return sample
    return TrackerSample(sample.station, sample.position, -sample.quaternion, sample.flag)
