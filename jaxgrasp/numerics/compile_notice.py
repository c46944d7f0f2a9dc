"""A line on a terminal's stderr when a call of this package compiles for long, once in a process.

JAX reports each phase of compiling to listeners. The stack at that moment tells whether the program belongs to a call
of this package; programs of the user's own are left alone.
"""

import os
import sys
import threading
import time
from types import FrameType

import jax

VARIABLE = "JAXGRASP_COMPILE_NOTICE"
"""Environment variable that, set to 0, turns off the line; read when it would be printed."""
PATIENCE_S = 2.0
"""Time that a call spends compiling before the line is printed [s]."""
TRACED, LOWERED, COMPILED = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)
"""Events of JAX at the end of each phase; XLA compiles between the last two."""
PACKAGE, NOT_CALLED = "jaxgrasp.", ("jaxgrasp.validation.", __name__)
"""Modules of this package, and those of them whose frames are around or inside the function that a user calls."""


class CompileNotice:
    """Listener that prints one line where a call of this package has compiled for longer than ``patience_s``."""

    def __init__(self, patience_s: float = PATIENCE_S) -> None:
        self._patience_s = patience_s
        self._lock = threading.Lock()
        self._is_due = False
        self._calls: dict[int, _CompilingCall] = {}

    def start(self) -> None:
        """Listen until the line is printed or ``stop`` is called, if stderr is a terminal."""
        if _prints():
            self._is_due = True
            jax.monitoring.register_event_duration_secs_listener(self._on_event)

    def stop(self) -> None:
        """Listen no longer."""
        with self._lock:
            was_due, self._is_due = self._is_due, False
        if was_due:
            jax.monitoring.unregister_event_duration_listener(self._on_event)

    def _on_event(self, event: str, duration_secs: float, **_: str | int) -> None:
        if event not in (TRACED, LOWERED, COMPILED) or not self._is_due:
            return
        thread = threading.get_ident()
        call = self._calls.get(thread)
        if call is not None and call.timer is not None:
            call.timer.cancel()
            call.timer = None
        frame = _outermost_frame(sys._getframe())
        if frame is None:
            return
        # The frame's number, since the frame itself would keep the call's arrays.
        if call is None or call.frame_id != id(frame):
            call = self._calls[thread] = _CompilingCall(id(frame))
        call.add(duration_secs)
        if event == LOWERED:
            remaining_s = self._patience_s - call.total_s()
            name = frame.f_code.co_qualname
            if remaining_s <= 0:
                self._print(name)
            else:
                call.timer = threading.Timer(remaining_s, self._print, (name,))
                call.timer.daemon = True
                call.timer.start()

    def _print(self, name: str) -> None:
        with self._lock:
            is_due, self._is_due = self._is_due, False
        if not is_due:
            return
        # Unregistered by `stop` only: JAX may be going through its listeners at this moment.
        if _prints():
            cache_advice = (
                "" if _keeps_compiled_code() else "; jaxgrasp.use_cache() keeps the compiled code for the next run"
            )
            line = f"jaxgrasp: the first call of {name} with arrays of these shapes compiles, for seconds{cache_advice}"
            print(f"{line} ({VARIABLE}=0 turns this line off)", file=sys.stderr, flush=True)


class _CompilingCall:
    """A call of this package in one thread: the intervals of time in which it compiled."""

    def __init__(self, frame_id: int) -> None:
        self.frame_id = frame_id
        self.timer: threading.Timer | None = None
        self._intervals: list[tuple[float, float]] = []

    def add(self, duration_s: float) -> None:
        """Add a phase that ends now, in place of the phases inside it: a program is traced while another one is."""
        end = time.perf_counter()
        start = end - duration_s
        self._intervals = [interval for interval in self._intervals if interval[0] < start]
        self._intervals.append((start, end))

    def total_s(self) -> float:
        return sum(end - start for start, end in self._intervals)


def _outermost_frame(frame: FrameType | None) -> FrameType | None:
    """Return the frame of this package's function that the user called; None where none of ours is on the stack."""
    outermost = None
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module.startswith(PACKAGE) and not module.startswith(NOT_CALLED):
            outermost = frame
        frame = frame.f_back
    return outermost


def _keeps_compiled_code() -> bool:
    return getattr(jax.config, "jax_compilation_cache_dir", None) is not None


def _prints() -> bool:
    # Without a console, as under pythonw, there is no stderr at all.
    return os.environ.get(VARIABLE) != "0" and sys.stderr is not None and sys.stderr.isatty()
