"""Stimuli of the psychophysics on a glove: rendered by it, predicted for it, and the errors of its rendering."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState, holding_time
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import nominal_sensors
from jaxgrasp.glove.simulated.simulated_glove import Cable
from jaxgrasp.glove.substitution import Sensations, torque_amplitudes
from jaxgrasp.lab.felt_objects import PALM_UP, FeltObject, LawOfAngles, Rendering, resistances
from jaxgrasp.lab.haptic_loop import MAX_DT, run_loop
from jaxgrasp.model.hand import Pose
from jaxgrasp.psychophysics.plan import FEEDBACKS
from jaxgrasp.psychophysics.prediction import RenderingError
from jaxgrasp.psychophysics.trial import NotFeltError, PredictedStimulus, Rendered, StimulusLostError
from jaxgrasp.validation.checked import checked

RATE = 100.0
"""Rate of the laws of torque [Hz]."""
FULL_SHARE = 0.9
"""Share of an intensity that counts as all of it."""
MAX_STATE_AGE = 0.1
"""Age of the glove's last state beyond which it is unknown [s]."""


class PredictedGloveStimulus(PredictedStimulus):
    """Prediction of a glove's rendering of an intensity, over all postures in which it is felt."""

    def __init__(self, target: FeltObject, model: GloveModel, rendering: Rendering | None = None) -> None:
        """Store the felt object, the model of the glove with its limits, and the renderer; the object's own law by
        default."""
        super().__init__()
        self._target, self._model = target, model
        self._rendering = LawOfAngles(target) if rendering is None else rendering
        self._predictions: dict[float, Rendered] = {}

    def predict(self, intensity: float) -> Rendered:
        if intensity not in self._predictions:
            self._predictions[intensity] = rendered(
                intensity, self._rendering.predicted_torques(intensity), self._model
            )
        return self._predictions[intensity]


class GloveStimulus(PredictedGloveStimulus):
    """An intensity rendered by a real glove: laws are sent at a constant rate, from the start until ``close``."""

    def __init__(
        self,
        target: FeltObject,
        model: GloveModel,
        glove: GloveProcess,
        rendering: Rendering | None = None,
        watch: Callable[[GloveState, TorqueLaw], None] = lambda state, law: None,
    ) -> None:
        """Start with no intensity, in a glove that is armed elsewhere; ``watch`` is called with each law, and must be
        fast."""
        super().__init__(target, model, rendering)
        # Compiling after the glove is armed would delay laws, and the glove would release.
        self._rendering.tick(0.0, np.zeros(len(model.joints)))
        self._glove, self._watch = glove, watch
        self._stop_event = threading.Event()
        self._lock = threading.Lock()
        self._condition = ""
        self._can_vibrate = False
        """True once the glove has said that it has vibration channels."""
        self._is_begun = False
        """True from ``begin`` to ``end``."""
        self._armed = True
        """True if the glove was armed throughout, since ``begin``."""
        self._reset()
        self._rendered: tuple[float, _Measured] | None = None
        self._state: GloveState | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def set_condition(self, condition: str) -> None:
        """Set what later intensities are felt by: torques (``force`` or the empty text), ``vibration``, ``both``, or
        ``none`` of these.

        Raises:
            ValueError: for another condition, and for a vibration on a glove without a vibration channel.
        """
        if condition not in ("", *FEEDBACKS):
            raise ValueError(f"condition is {condition!r}: expected one of {', '.join(FEEDBACKS)}")
        if condition in ("vibration", "both") and not self._can_vibrate:
            # Asked once: later calls come between the intervals of a trial.
            self._can_vibrate = bool(self._glove.report().get("vibrators"))
            if not self._can_vibrate:
                raise ValueError(
                    f"condition is {condition!r}: expected 'force' or 'none', since the glove cannot vibrate"
                )
        with self._lock:
            self._condition = condition

    def begin(self, intensity: float) -> None:
        """Start the stimulus.

        Raises:
            StimulusLostError: if the glove is not armed.
        """
        self._check_armed()
        with self._lock:
            self._intensity = intensity
            self._reset()
            self._is_begun = True

    def is_lost(self) -> bool:
        if not self._is_begun:
            return False
        is_following = self._is_following()
        with self._lock:
            # It stays lost, or a glove that comes back would make a whole stimulus of a part.
            self._armed = self._armed and is_following
            return not self._armed

    def end(self) -> Rendered:
        """End the stimulus.

        Raises:
            StimulusLostError: if the glove was not armed throughout.
            NotFeltError: if there was an intensity, but the hand never moved to feel it.
        """
        with self._lock:
            measured, armed = self._measured, self._armed
            result = measured.rendered(self._intensity)
            self._intensity = 0.0
            self._is_begun = False
        if not (armed and self._is_following()):
            raise StimulusLostError(f"the glove released during the stimulus{self._release_cause()}", result)
        if result.intensity > 0 and not result.torque > 0:
            raise NotFeltError("no finger felt the stimulus", result)
        return result

    def wait_until_armed(self, patience: float) -> None:
        """Wait until the glove is armed.

        Raises:
            OSError: if it is not armed within ``patience`` [s].
        """
        started = time.perf_counter()
        # A state from before this call may belong to an earlier arming.
        while (state := self._glove.state()) is None or state.at < started or not _is_armed(state):
            if time.perf_counter() > started + patience:
                raise OSError(f"the glove was not armed within {patience:g} s{self._release_cause()}")
            time.sleep(0.02)

    def close(self) -> None:
        """Stop sending laws."""
        self._stop_event.set()
        self._thread.join()

    def _reset(self) -> None:
        """Reset the measurement, and the record that the glove was armed throughout."""
        self._measured, self._armed = _Measured(list(self._target.channels())), True

    def _check_armed(self) -> None:
        if not self._is_following():
            raise StimulusLostError(f"the glove is not armed{self._release_cause()}")

    def _is_following(self) -> bool:
        """Return whether laws are sent, and the glove has recently confirmed that it follows them."""
        state = self._glove.state()
        if state is None or not (self._thread.is_alive() and self._glove.is_alive()):
            return False
        return _is_armed(state) and time.perf_counter() - state.at < MAX_STATE_AGE

    def _release_cause(self) -> str:
        """Return the cause of the last release, from the guard or the line."""
        if not self._glove.is_alive():
            return ": the process that owned its line has ended"
        events = self._glove.events()
        cause = next((event["cause"] or event["trouble"] for event in reversed(events) if event["cause"]), "")
        return f": {cause}" if cause else ""

    def _run(self) -> None:
        run_loop(
            self._tick,
            self._read,
            self._glove.write,
            lambda timestamp: PALM_UP,
            RATE,
            lambda timestamp: not self._stop_event.is_set(),
        )

    def _read(self) -> GloveState | None:
        state = self._glove.state()
        if state is not None:
            with self._lock:
                self._armed = self._armed and _is_armed(state)
            self._state = state
        return state

    def _tick(self, timestamp: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TorqueLaw:
        with self._lock:
            intensity, measured, condition = self._intensity, self._measured, self._condition
        # Only the ticking thread starts to render another intensity.
        if self._rendered != (intensity, measured):
            self._rendering.begin(intensity)
            self._rendered = intensity, measured
        tick = self._rendering.tick(timestamp, angles)
        rendering = rendered(tick.share, tick.law.torques[None], self._model) if tick.is_alone else None
        with self._lock:
            measured.add(timestamp, angles, rendering)
        law = law_in_condition(tick.law, condition, self._model)
        if self._state is not None:
            self._watch(self._state, law)
        return law


def law_in_condition(law: TorqueLaw, condition: str, model: GloveModel) -> TorqueLaw:
    """Return the law that renders torques as a condition says: by themselves, by vibration, by both, or not at all."""
    if condition in ("vibration", "both"):
        amplitudes = torque_amplitudes(law.torques, np.array(model.limits), model.joints)
        law = replace(law, sensations=Sensations(amplitudes, np.zeros(len(amplitudes))))
    if condition in ("vibration", "none"):
        return replace(law, torques=np.zeros_like(law.torques), derivative=np.zeros_like(law.derivative))
    return law


class _Measured:
    """Measurement of one intensity, tick by tick."""

    def __init__(self, channels: list[int]) -> None:
        """Start empty; the channels are those of the joints that feel it."""
        self._channels = channels
        self._torque, self._peak, self._full_s, self._cut = 0.0, 0.0, 0.0, False
        self._low, self._high = np.full(len(channels), np.inf), np.full(len(channels), -np.inf)
        self._last_timestamp: float | None = None

    def add(self, timestamp: float, angles: Float[np.ndarray, "channels"], rendering: Rendered | None) -> None:
        """Add a tick: the angles, and the rendering of an intensity of 1; None where it was not felt alone."""
        measured = angles[self._channels]
        self._low, self._high = np.minimum(self._low, measured), np.maximum(self._high, measured)
        elapsed_s = 0.0 if self._last_timestamp is None else min(timestamp - self._last_timestamp, MAX_DT)
        self._last_timestamp = timestamp
        if rendering is not None:
            self._torque, self._peak = max(self._torque, rendering.torque), max(self._peak, rendering.felt_intensity)
            self._cut = self._cut or rendering.saturated
            self._full_s += elapsed_s if rendering.felt_intensity >= FULL_SHARE else 0.0

    def rendered(self, intensity: float) -> Rendered:
        """Summarise the measurement."""
        motion_deg = float(np.degrees(np.max(self._high - self._low))) if self._last_timestamp is not None else 0.0
        felt_intensity = intensity * self._peak
        return Rendered(
            intensity, felt_intensity, self._torque, self._cut, full_intensity_s=self._full_s, motion_deg=motion_deg
        )


def _is_armed(state: GloveState) -> bool:
    return state.guard == GuardState.ARMED and state.link == LinkState.ARMED


def rendered(intensity: float, torques: Float[np.ndarray, "P channels"], model: GloveModel) -> Rendered:
    """Clip torques to a glove's limits; the felt intensity is the least remaining share of their sum."""
    limits = np.array(model.limits)
    clipped = np.clip(torques, 0, limits)
    sums = np.clip(torques, 0, None).sum(1)
    shares = np.where(sums > 0, clipped.sum(1) / np.where(sums > 0, sums, 1), 1.0)
    felt_intensity, cut = float(intensity * shares.min()), bool(np.any(torques > limits))
    return Rendered(intensity, felt_intensity, float(torques.max()), cut, float(holding_time(model, torques).min()))


@checked
def glove_error(
    target: FeltObject,
    model: GloveModel,
    *,
    cable: Cable | None = None,
    pretension: float = 0.0,
    lag: float = 0.0,
    motions: float = 7.0,
) -> RenderingError:
    """Compute the rendering errors of a glove for a stimulus, at the joint that bears most of it.

    Args:
        target: the stimulus.
        model: model of the glove, with its limits and its quantum.
        cable: cable with its friction in motion; no friction if None.
        pretension: tension that keeps the cables taut [N].
        lag: delay times the stimulus' own relative rate of change.
        motions: number of motions over which a person averages errors that depend on the direction.

    Raises:
        ValueError: for a negative pretension, and as RenderingError does.
    """
    if not (np.isfinite(pretension) and pretension >= 0):
        raise ValueError(f"pretension is {pretension}: expected a finite number, 0 or more")
    unit_torques = np.asarray(resistances(target, target.postures(), 1.0))
    posture, channel = np.unravel_index(np.argmax(unit_torques / np.array(model.limits)), unit_torques.shape)
    torque = float(unit_torques[posture, channel])
    friction = 0.0 if cable is None else cable.sliding * cable.wrap
    arm = float(nominal_sensors(model).gauges.arm[channel])
    return RenderingError(
        quantum=model.quantum / torque,
        friction=friction,
        pretension=pretension * arm / torque,
        lag=lag,
        limit=model.limits[channel] / torque,
        motions=motions,
    )
