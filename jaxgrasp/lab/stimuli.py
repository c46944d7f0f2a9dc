"""Stimuli of the psychophysics, rendered: predicted for a glove, or felt in one."""

import threading
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.warmth import lasts
from jaxgrasp.lab.felt_objects import PALM_UP, FeltObject, LawOfAngles, Rendering
from jaxgrasp.lab.haptic_loop import LONGEST, run_loop
from jaxgrasp.model.hand import Pose
from jaxgrasp.psychophysics.stimulus import NotFeltError, PredictedStimulus, Rendered, StimulusLostError

RATE = 100.0
"""Frequency at which laws of torque go out to the glove [Hz]."""
NEARLY_WHOLE = 0.9
"""Share of an intensity that is felt as all of it."""
FRESH = 0.1
"""Age of the glove's word beyond which nobody knows what it does [s]."""


class PredictedGloveStimulus(PredictedStimulus):
    """What a glove can render of an intensity, over all postures in which it is felt."""

    def __init__(self, felt: FeltObject, model: GloveModel, rendering: Rendering | None = None) -> None:
        """Args: what is felt; the glove, whose limits count; and how it is rendered, by its own law if not given."""
        super().__init__()
        self._felt, self._model = felt, model
        self._rendering = LawOfAngles(felt) if rendering is None else rendering
        self._known: dict[float, Rendered] = {}

    def predict(self, intensity: float) -> Rendered:
        if intensity not in self._known:
            self._known[intensity] = rendered(intensity, self._rendering.on_the_way(intensity), self._model)
        return self._known[intensity]


class GloveStimulus(PredictedGloveStimulus):
    """An intensity rendered by a real glove: laws go out at a steady rate, from the first until ``close``."""

    def __init__(
        self,
        felt: FeltObject,
        model: GloveModel,
        glove: GloveProcess,
        rendering: Rendering | None = None,
        watch: Callable[[GloveState, TorqueLaw], None] = lambda state, law: None,
    ) -> None:
        """A stimulus of no intensity, in a glove that someone arms; ``watch`` is told of each law, quickly."""
        super().__init__(felt, model, rendering)
        # What compiles once the glove is armed would hold laws up, and it lets go.
        self._rendering.tick(0.0, np.zeros(len(model.joints)))
        self._glove, self._watch = glove, watch
        self._ends = threading.Event()
        self._lock = threading.Lock()
        self._forget()
        self._rendered: tuple[float, _Measured] | None = None
        self._state: GloveState | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def begin(self, intensity: float) -> None:
        """Let it be felt.

        Raises:
            StimulusLostError: where the glove is not armed.
        """
        self._check_armed()
        with self._lock:
            self._intensity = intensity
            self._forget()

    def end(self) -> Rendered:
        """Let it end.

        Raises:
            StimulusLostError: where the glove was not armed all the time.
            NotFeltError: where there was something to be felt, and the hand never did what it takes.
        """
        with self._lock:
            measured, armed = self._measured, self._armed
            found = measured.rendered(self._intensity)
            self._intensity = 0.0
        if not (armed and self._holds()):
            raise StimulusLostError(f"the glove let go while it was felt{self._why()}", found)
        if found.intensity > 0 and not found.torque > 0:
            raise NotFeltError("no finger has felt it", found)
        return found

    def wait_until_armed(self, patience: float) -> None:
        """Return once the glove is armed.

        Raises:
            OSError: if it is not, after so long [s].
        """
        begun = time.perf_counter()
        # What was said before this call may be of an arming before.
        while (state := self._glove.state()) is None or state.at < begun or not _is_armed(state):
            if time.perf_counter() > begun + patience:
                raise OSError(f"the glove was not armed within {patience:g} s")
            time.sleep(0.02)

    def close(self) -> None:
        """No more laws."""
        self._ends.set()
        self._thread.join()

    def _forget(self) -> None:
        """Nothing is measured yet, and the glove was armed throughout."""
        self._measured, self._armed = _Measured(list(self._felt.channels())), True

    def _check_armed(self) -> None:
        if not self._holds():
            raise StimulusLostError(f"the glove is not armed{self._why()}")

    def _holds(self) -> bool:
        """Whether laws go out and someone who is there says that they are followed."""
        state = self._glove.state()
        if state is None or not (self._thread.is_alive() and self._glove.is_alive()):
            return False
        return _is_armed(state) and time.perf_counter() - state.at < FRESH

    def _why(self) -> str:
        """Why it let go last, as its guard or its line has it."""
        if not self._glove.is_alive():
            return ": the process that owned its line has ended"
        events = self._glove.events()
        cause = next((event["cause"] or event["trouble"] for event in reversed(events) if event["cause"]), "")
        return f": {cause}" if cause else ""

    def _run(self) -> None:
        run_loop(
            self._tick, self._read, self._glove.write, lambda now: PALM_UP, RATE, lambda now: not self._ends.is_set()
        )

    def _read(self) -> GloveState | None:
        state = self._glove.state()
        if state is not None:
            with self._lock:
                self._armed = self._armed and _is_armed(state)
            self._state = state
        return state

    def _tick(self, now: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TorqueLaw:
        with self._lock:
            intensity, measured = self._intensity, self._measured
        # The thread that ticks is the one that renders: it alone begins another intensity.
        if self._rendered != (intensity, measured):
            self._rendering.begin(intensity)
            self._rendered = intensity, measured
        felt = self._rendering.tick(now, angles)
        given = rendered(felt.share, felt.law.torques[None], self._model) if felt.is_alone else None
        with self._lock:
            measured.add(now, angles, given)
        if self._state is not None:
            self._watch(self._state, felt.law)
        return felt.law


class _Measured:
    """What came of one intensity, tick by tick."""

    def __init__(self, channels: list[int]) -> None:
        """Nothing yet; the channels are those of the joints that feel it."""
        self._channels = channels
        self._torque, self._peak, self._whole, self._cut = 0.0, 0.0, 0.0, False
        self._low, self._high = np.full(len(channels), np.inf), np.full(len(channels), -np.inf)
        self._before: float | None = None

    def add(self, now: float, angles: Float[np.ndarray, "channels"], given: Rendered | None) -> None:
        """A tick: the angles, and what was given of an intensity of 1; None where it was not felt alone."""
        own = angles[self._channels]
        self._low, self._high = np.minimum(self._low, own), np.maximum(self._high, own)
        passed = 0.0 if self._before is None else min(now - self._before, LONGEST)
        self._before = now
        if given is not None:
            self._torque, self._peak = max(self._torque, given.torque), max(self._peak, given.felt)
            self._cut = self._cut or given.saturated
            self._whole += passed if given.felt >= NEARLY_WHOLE else 0.0

    def rendered(self, intensity: float) -> Rendered:
        """All of it."""
        moved = float(np.degrees(np.max(self._high - self._low))) if self._before is not None else 0.0
        felt = intensity * self._peak
        return Rendered(intensity, felt, self._torque, self._cut, whole=self._whole, moved=moved)


def _is_armed(state: GloveState) -> bool:
    return state.guard == GuardState.ARMED and state.link == LinkState.ARMED


def rendered(intensity: float, asked: Float[np.ndarray, "P channels"], model: GloveModel) -> Rendered:
    """What a glove's limits leave of torques; felt is the share that is left of their sum, where it is least."""
    limits = np.array(model.limits)
    given = np.clip(asked, 0, limits)
    sums = np.clip(asked, 0, None).sum(1)
    shares = np.where(sums > 0, given.sum(1) / np.where(sums > 0, sums, 1), 1.0)
    felt, cut = float(intensity * shares.min()), bool(np.any(asked > limits))
    return Rendered(intensity, felt, float(asked.max()), cut, float(lasts(model, asked).min()))
