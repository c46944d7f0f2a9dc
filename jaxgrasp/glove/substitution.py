"""Sensory substitution: contacts of a finger as the amplitude of a vibration, its grip as warmth, and their sending.

A slip that a force display cannot render, because the force is small, saturated or absent, can be told by another
sense [1]. The law here has three causes of vibration, each of which alone suffices:

- slip margin: amplitude rises from 0 to 1 as the contact force nears its friction cone;
- contact onset: a pulse that decays where a finger begins to touch, as the transients that fast-adapting receptors of
  the skin signal at contact [2];
- saturation: the part of the torque that the law asks for and the glove does not give.

The amplitude is the largest of the three, so that no cause hides another. The device bounds the temperature itself
(rule 11 of ``protocol/firmware/PROTOCOL.md``), whatever this law asks for.

At some turns of the host's line vibration and heat take the place of torques: values are checked, and sent when due.

[1] M. J. Massimino, T. B. Sheridan, Sensory substitution for force feedback in teleoperation, Presence 2(4), 1993.
[2] R. S. Johansson, J. R. Flanagan, Coding and use of tactile signals from the fingertips in object manipulation tasks,
Nature Reviews Neuroscience 10, 2009.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrasp.glove.protocol.device import HEAT_WATCHDOG, HOTTEST, MAX_AMPLITUDE, N_FINGERS, VIBRATION_WATCHDOG
from jaxgrasp.glove.protocol.frames import Kind
from jaxgrasp.validation.checked import check_positive, checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
"""Fingers in the order of the vibration and heat channels."""
MAX_TEMPERATURE = HOTTEST / 100
"""Bound that every device keeps by itself [deg C]."""


class Sensations(NamedTuple):
    """Vibration and heat that a person is to feel, by finger."""

    amplitudes: Float[np.ndarray, "5"]
    """Amplitudes of the vibration, 0 to 1."""
    temperatures: Float[np.ndarray, "5"]
    """Target temperatures [deg C]; 0 for a heater that is off."""

    @staticmethod
    def none() -> "Sensations":
        """Return silence: no vibration, and no heat."""
        return Sensations(np.zeros(N_FINGERS), np.zeros(N_FINGERS))

    def vector(self) -> Float[np.ndarray, "10"]:
        """Pack the sensations into one vector."""
        return np.concatenate([self.amplitudes, self.temperatures])

    @staticmethod
    def of(vector: Float[np.ndarray, "10"]) -> "Sensations":
        """Unpack sensations from their vector; numbers that are not finite give silence."""
        if not np.all(np.isfinite(vector)):
            return Sensations.none()
        return Sensations(vector[:N_FINGERS], vector[N_FINGERS:])


@dataclass(frozen=True)
class SubstitutionLaw:
    """Numbers of the law from contacts to sensations.

    Raises:
        ValueError: for a number that is out of its range.
    """

    friction: float = 0.5
    """Coefficient of friction that the slip margin is taken with."""
    warning_margin: float = 0.3
    """Slip margin below which a finger vibrates: at 0, the edge of the cone, the amplitude is 1."""
    onset_amplitude: float = 0.6
    """Amplitude of the pulse at the moment of contact; 0 for none."""
    onset_decay: float = 0.04
    """Time constant of that pulse [s]."""
    saturation_amplitude: float = 0.5
    """Amplitude where none of the torque that is asked for is given; 0 for none."""
    touch_force: float = 0.05
    """Normal force from which on a finger touches [N]; it lets go below half of it."""
    full_force: float = 8.0
    """Normal force at which the heat channel has its highest temperature [N]."""
    resting_temperature: float = 34.0
    """Target temperature of a finger that just touches [deg C]."""
    highest_temperature: float = 34.0
    """Target temperature at ``full_force`` [deg C]; the resting temperature for no heat."""

    def __post_init__(self):
        for name in ("onset_amplitude", "saturation_amplitude"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)}: expected 0 to 1")
        check_positive(self, "friction", "warning_margin", "onset_decay", "touch_force", "full_force")
        if self.warning_margin > 1:
            raise ValueError(f"warning_margin is {self.warning_margin}: expected at most 1")
        for name, low in (("resting_temperature", 0.0), ("highest_temperature", self.resting_temperature)):
            if not low <= getattr(self, name) <= MAX_TEMPERATURE:
                raise ValueError(f"{name} is {getattr(self, name)}: expected {low:g} to {MAX_TEMPERATURE:g} deg C")


@checked
def slip_margins(
    forces: Float[np.ndarray, "C 3"], normals: Float[np.ndarray, "C 3"], friction: float
) -> Float[np.ndarray, "C"]:
    """Compute each contact's distance from slipping, relative to its normal force: 1 - |f_t| / (mu f_n).

    The margin is 1 for a force along the normal, 0 on the friction cone, and negative beyond it; -inf for a tangential
    force without a normal one, and +inf for a contact without a force.

    Args:
        forces: of the hand on the object [N].
        normals: unit vectors into the object.
        friction: coefficient of friction, more than 0.

    Raises:
        ValueError: for a coefficient that is not positive, and forces and normals of different numbers of contacts.
    """
    pressing, sliding = _split_forces(forces, normals, friction)
    with np.errstate(divide="ignore", invalid="ignore"):
        margins = 1 - sliding / (friction * np.maximum(pressing, 0.0))
    return np.where((pressing <= 0) & (sliding == 0), np.inf, margins)


@checked
def finger_contacts(
    forces: Float[np.ndarray, "C 3"], normals: Float[np.ndarray, "C 3"], fingers: Int[np.ndarray, "C"], friction: float
) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "5"]]:
    """Compute each finger's normal force [N] and slip margin, which is that of its contacts' whole tangential load.

    The margin of a finger is 1 - sum |f_t| / (mu sum f_n), so that a small contact at the rim of a firm one does not
    vibrate; +inf for a finger that does not touch.

    Args:
        forces: of the hand on the object [N].
        normals: unit vectors into the object.
        fingers: index of each contact's finger in ``FINGERS``; contacts of -1, as of the palm, are left out.
        friction: coefficient of friction, more than 0.

    Raises:
        ValueError: as [`slip_margins`][jaxgrasp.glove.substitution.slip_margins], and for an index of no finger.
    """
    pressing, sliding = _split_forces(forces, normals, friction)
    for k, finger in enumerate(fingers):
        if not -1 <= finger < N_FINGERS:
            raise ValueError(f"fingers[{k}] is {finger}: expected -1 to {N_FINGERS - 1}")
    is_felt = fingers >= 0
    # Of no contact at all, bincount returns whole numbers.
    normal = np.bincount(fingers[is_felt], np.maximum(pressing, 0.0)[is_felt], N_FINGERS).astype(float)
    tangential = np.bincount(fingers[is_felt], sliding[is_felt], N_FINGERS).astype(float)
    with np.errstate(divide="ignore", invalid="ignore"):
        margins = 1 - tangential / (friction * normal)
    return normal, np.where((normal <= 0) & (tangential == 0), np.inf, margins)


def _split_forces(
    forces: Float[np.ndarray, "C 3"], normals: Float[np.ndarray, "C 3"], friction: float
) -> tuple[Float[np.ndarray, "C"], Float[np.ndarray, "C"]]:
    """Return the normal forces and the magnitudes of the tangential ones, after a check of the arguments."""
    if not (math.isfinite(friction) and friction > 0):
        raise ValueError(f"friction is {friction}: expected a positive number")
    if len(forces) != len(normals):
        raise ValueError(f"normals has {len(normals)} rows: expected {len(forces)}, as forces has")
    pressing = np.sum(forces * normals, -1)
    sliding = np.linalg.norm(forces - pressing[:, None] * normals, axis=-1)
    return pressing, sliding


@checked
def finger_saturation(
    asked: Float[np.ndarray, "channels"], limits: Float[np.ndarray, "channels"], joints: Sequence[str]
) -> Float[np.ndarray, "5"]:
    """Compute the largest share of a joint's torque that is not given, by finger, 0 to 1; joints without a motor, of
    limit 0, do not count.

    Args:
        asked: torques before the glove's limits [N.m].
        limits: largest torques [N.m].
        joints: names of the joints, each beginning with its finger's.

    Raises:
        ValueError: for numbers of torques, limits and joints that differ.
    """
    _check_entries("asked", asked, limits, joints)
    shares = np.divide(asked - limits, asked, out=np.zeros(len(asked)), where=(asked > limits) & (limits > 0))
    return _largest_by_finger(shares, joints)


@checked
def torque_amplitudes(
    torques: Float[np.ndarray, "channels"], limits: Float[np.ndarray, "channels"], joints: Sequence[str]
) -> Float[np.ndarray, "5"]:
    """Compute the amplitudes that stand for torques: each finger's largest share of a joint's limit, 0 to 1.

    So a force that is not rendered, or rendered besides, is felt as the strength of a vibration.

    Args:
        torques: against flexion [N.m].
        limits: largest torques [N.m].
        joints: names of the joints, each beginning with its finger's.

    Raises:
        ValueError: for numbers of torques, limits and joints that differ.
    """
    _check_entries("torques", torques, limits, joints)
    shares = np.divide(torques, limits, out=np.zeros(len(torques)), where=limits > 0)
    return _largest_by_finger(np.minimum(shares, 1.0), joints)


def _check_entries(name: str, torques: np.ndarray, limits: np.ndarray, joints: Sequence[str]) -> None:
    """Raise ValueError unless there are as many torques, of this name, as limits and joints."""
    if not len(torques) == len(limits) == len(joints):
        raise ValueError(
            f"{name}, limits and joints have {len(torques)}, {len(limits)} and {len(joints)} entries: expected the same"
        )


def _largest_by_finger(shares: Float[np.ndarray, "channels"], joints: Sequence[str]) -> Float[np.ndarray, "5"]:
    """Return the largest of the joints' shares by finger, at least 0; shares that are not numbers do not count."""
    fingers, largest = finger_indices(tuple(joints)), np.zeros(N_FINGERS)
    np.fmax.at(largest, fingers[fingers >= 0], shares[fingers >= 0])
    return largest


@lru_cache(64)
def finger_indices(names: tuple[str, ...]) -> Int[np.ndarray, "names"]:
    """Return the index in ``FINGERS`` of the finger that each joint's or link's name begins with; -1 for none."""
    firsts = [(name.split() or [""])[0] for name in names]
    indices = np.array([FINGERS.index(first) if first in FINGERS else -1 for first in firsts], int)
    indices.flags.writeable = False
    return indices


class Substitution:
    """Sensations from contacts over time: a law, and the moments at which fingers began to touch."""

    def __init__(self, law: SubstitutionLaw | None = None) -> None:
        """Create a substitution of fingers that do not touch."""
        self.law = SubstitutionLaw() if law is None else law
        self._touched_at = np.full(N_FINGERS, -np.inf)
        self._are_touching = np.zeros(N_FINGERS, bool)

    def step(
        self,
        timestamp: float,
        normal_forces: Float[np.ndarray, "5"],
        margins: Float[np.ndarray, "5"],
        saturation: Float[np.ndarray, "5"] | None = None,
    ) -> Sensations:
        """Compute the sensations at a time.

        Args:
            timestamp: time that never runs backwards [s].
            normal_forces: by finger [N].
            margins: slip margins by finger.
            saturation: share of the torque that is not given, by finger, 0 to 1; zero where not given.
        """
        law = self.law
        # What is not a number is no contact: comparisons with NaN are false.
        threshold = np.where(self._are_touching, 0.5 * law.touch_force, law.touch_force)
        are_touching = normal_forces >= threshold
        self._touched_at = np.where(are_touching & ~self._are_touching, timestamp, self._touched_at)
        self._are_touching = are_touching
        slip = 1 - np.clip(np.where(np.isnan(margins), np.inf, margins), 0.0, law.warning_margin) / law.warning_margin
        onset = law.onset_amplitude * np.exp(-np.maximum(timestamp - self._touched_at, 0.0) / law.onset_decay)
        cut = np.zeros(N_FINGERS) if saturation is None else np.clip(np.nan_to_num(saturation), 0.0, 1.0)
        amplitudes = np.maximum(np.maximum(slip, onset), law.saturation_amplitude * cut)
        temperatures = np.zeros(N_FINGERS)
        if law.highest_temperature > law.resting_temperature:
            share = np.clip(np.nan_to_num(normal_forces) / law.full_force, 0.0, 1.0)
            temperatures = law.resting_temperature + share * (law.highest_temperature - law.resting_temperature)
        return Sensations(np.where(are_touching, amplitudes, 0.0), np.where(are_touching, temperatures, 0.0))


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
