"""A tracker on a line: asked for each pose, or streaming them; the newest believable one."""

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
"""Decoder of each protocol, and what sets it up: output list, metric units, ASCII (``F``) or binary (``f``)."""
STREAM, STOP, ASK = b"C", b"c", b"P"
IMPATIENT = 0.2
"""Time without an answer after which it is asked again [s]."""


class Tracker:
    """The wrist's pose from a Polhemus tracker; neither call waits."""

    def __init__(
        self,
        line: Line,
        protocol: Protocol,
        *,
        streams: bool = True,
        station: int = 1,
        jumps: JumpFilter | None = None,
    ) -> None:
        """A tracker that is set up by these bytes, which it answers with none.

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
        kind, setting_up = PROTOCOLS[protocol]
        self.decoder = kind()
        self.jumps = jumps or JumpFilter()
        self.sample: TrackerSample | None = None
        self.sampled_at = -math.inf
        """When the sample came [s]."""
        self._line, self._streams, self._station = line, streams, station
        self._asked_at, self._waits = -math.inf, False
        line.write(STOP + b"".join(setting_up) + (STREAM if streams else b""))

    def poll(self, now: float) -> TrackerSample | None:
        """Take what came, ask for more where it must be asked; the newest sample.

        Raises:
            LineError: if the line is gone.
        """
        for sample in self.decoder.feed(self._line.read()):
            self._waits = False
            if sample.station == self._station and self.jumps.passes(now, sample):
                self.sample, self.sampled_at = _continued(sample, self.sample), now
        if not self._streams and (not self._waits or now - self._asked_at > IMPATIENT):
            self._waits, self._asked_at = True, now
            self._line.write(ASK)
        return self.sample

    def close(self) -> None:
        """Stop the stream, if the line still is there, and let go of it."""
        try:
            self._line.write(STOP)
        except LineError:
            self._waits = False
        self._line.close()


def _continued(sample: TrackerSample, before: TrackerSample | None) -> TrackerSample:
    """A sample with that of its rotation's two quaternions that is nearer to the last."""
    if before is None or np.dot(sample.quaternion, before.quaternion) >= 0:
        return sample
    return TrackerSample(sample.station, sample.position, -sample.quaternion, sample.flag)
