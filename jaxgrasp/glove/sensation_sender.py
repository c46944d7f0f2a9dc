"""Turns of a host's line at which vibration and heat take the place of torques: values checked, and sent when due."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.glove.protocol.device import HEAT_WATCHDOG, HOTTEST, MAX_AMPLITUDE, N_FINGERS, VIBRATION_WATCHDOG
from jaxgrasp.glove.protocol.frames import Kind
from jaxgrasp.glove.substitution import Sensations

VIBRATION_PERIOD, HEAT_PERIOD = 0.02, 0.08
"""Times after which a vibration and a heat that go on are sent again [s], several times within their watchdogs."""
AMPLITUDE_STEP, TEMPERATURE_STEP = 10, 20
"""Changes from which on new values are sent at once [1/1000] and [1/100 deg C]; an end is always sent at once."""


class _Channels(NamedTuple):
    scale: int
    """Counts of a unit: of an amplitude of 1, and of 1 deg C."""
    most: int
    """Largest count."""
    step: int
    period: float


CHANNELS = {
    Kind.VIBRATE: _Channels(MAX_AMPLITUDE, MAX_AMPLITUDE, AMPLITUDE_STEP, VIBRATION_PERIOD),
    Kind.HEAT: _Channels(100, HOTTEST, TEMPERATURE_STEP, HEAT_PERIOD),
}
"""Channels of vibration and of heat by the kind of their frame, in the order of ``Sensations``."""


class SensationSender:
    """The turns at which VIBRATE and HEAT take the place of a COMMAND: never two in a row."""

    def __init__(self) -> None:
        """Create a sender of silence, for a device without the channels."""
        self.vibrators = self.heaters = 0
        """Numbers of channels of the device; 0 where it has none, or its bounds are too wide."""
        self._requested = Sensations.none()
        self.forget()

    def forget(self) -> None:
        """Begin with a device that is silent, as after each greeting."""
        self._sent = dict.fromkeys(CHANNELS, (-np.inf, (0,) * N_FINGERS))
        self._was_last = False

    def learn(self, values: tuple[int, ...]) -> str:
        """Take what a CAPABILITY says of the channels; return why they are not used, empty if they are or are none."""
        vibrators, vibration_watchdog, heaters, heat_watchdog, hottest = values
        self.vibrators = self.heaters = 0
        self.forget()
        if vibrators and not (0 < vibrators <= N_FINGERS and 0 < vibration_watchdog <= VIBRATION_WATCHDOG):
            return (
                f"the device has {vibrators} vibration channels with a watchdog of {vibration_watchdog} ms: expected "
                f"1 to {N_FINGERS} channels and 1 to {VIBRATION_WATCHDOG} ms"
            )
        if heaters and not (0 < heaters <= N_FINGERS and 0 < heat_watchdog <= HEAT_WATCHDOG and 0 < hottest <= HOTTEST):
            return (
                f"the device has {heaters} heat channels with a watchdog of {heat_watchdog} ms and a bound of "
                f"{hottest / 100:g} deg C: expected 1 to {N_FINGERS} channels, 1 to {HEAT_WATCHDOG} ms, and at most "
                f"{HOTTEST / 100:g} deg C"
            )
        self.vibrators, self.heaters = vibrators, heaters
        return ""

    def request(self, sensations: Sensations) -> None:
        """Set what is to be sent; what is not a number is silence."""
        self._requested = sensations

    def due(self, timestamp: float) -> tuple[Kind, tuple[int, ...]] | None:
        """Return the frame that takes this turn, or None for the COMMAND."""
        counts = (self.vibrators, self.heaters)
        for (kind, channels), count, numbers in zip(CHANNELS.items(), counts, self._requested, strict=True):
            if self._was_last or not count:
                continue
            sent_at, sent = self._sent[kind]
            target = _to_counts(numbers, channels)
            largest = max(abs(new - old) for new, old in zip(target, sent, strict=True))
            is_new = largest >= channels.step or (any(sent) and not any(target))
            if is_new or (any(target) and timestamp - sent_at >= channels.period):
                return kind, target
        self._was_last = False
        return None

    def sent(self, timestamp: float, kind: Kind, values: tuple[int, ...]) -> None:
        """Record that the line took a frame."""
        self._sent[kind], self._was_last = (timestamp, values), True


def _to_counts(numbers: np.ndarray, channels: _Channels) -> tuple[int, ...]:
    counts = np.round(channels.scale * np.nan_to_num(numbers, posinf=0.0, neginf=0.0))
    return tuple(int(count) for count in np.clip(counts, 0, channels.most))
