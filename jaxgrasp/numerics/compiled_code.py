"""Compiled code: where it is kept between processes, and how it is made.

A line on a terminal's stderr when a call of this package compiles for long, once for each function.

JAX reports each phase of compiling to listeners. The stack at that moment tells whether the program belongs to a call
of this package; programs of the user's own are left alone.
"""

import inspect
import os
import sys
import threading
import time
import warnings
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from functools import cache, wraps
from importlib.metadata import entry_points
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental.compilation_cache import compilation_cache

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
    """Listener that prints a line where a call of this package has compiled for longer than ``patience_s``.

    There is one line for each of the package's functions.
    """

    def __init__(self, patience_s: float = PATIENCE_S) -> None:
        self._patience_s = patience_s
        self._lock = threading.Lock()
        self._is_listening = False
        self._named: set[str] = set()
        self._calls: dict[int, _CompilingCall] = {}

    def start(self) -> None:
        """Listen until ``stop`` is called, if stderr is a terminal."""
        if _prints():
            self._is_listening = True
            jax.monitoring.register_event_duration_secs_listener(self._on_event)

    def stop(self) -> None:
        """Listen no longer."""
        if self._is_listening:
            self._is_listening = False
            jax.monitoring.unregister_event_duration_listener(self._on_event)

    def _on_event(self, event: str, duration_secs: float, **_: str | int) -> None:
        if event not in (TRACED, LOWERED, COMPILED):
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
        # Unregistered by `stop` only: JAX may be going through its listeners at this moment.
        if not (self._is_listening and _prints()):
            return
        with self._lock:
            if name in self._named:
                return
            is_first = not self._named
            self._named.add(name)
        line = f"jaxgrasp: the first call of {name} with arrays of these shapes compiles, for seconds"
        if is_first:
            advice = "" if _keeps_compiled_code() else "; jaxgrasp.use_cache() keeps the compiled code for the next run"
            line += f"{advice} ({VARIABLE}=0 turns such lines off)"
        print(line, file=sys.stderr, flush=True)


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


LEAST_SECONDS = 0.1
"""Programs that compile faster than this are not worth a file."""
MEASURED_SINCE, UNMEASURED_FROM = (0, 10), (0, 13)
"""Versions of JAX that are measured and tested: from the first, up to but without the second (see CONTRIBUTING.md)."""
LOOPS_MERGED_FROM = (0, 12)
"""The first version whose XLA makes one kernel of a whole loop, however large its arrays and the code in it are."""
COMPILED_FOR_FIRST_CALL: dict[str, bool | int] = {"xla_backend_optimization_level": 2}
"""Options of programs that answer plain calls. Level 2 compiles the optimum in two thirds of the time of level 3, to
code that takes a fifth longer. Vectors of 512 bits (``xla_cpu_prefer_vector_width``) would win most of that back, but
with JAX 0.10 they gave wrong arctangents on processors that have them."""
OLDER_EMITTERS: dict[str, bool | int] = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
"""A fifth to a third less time to compile, to code that is as fast on small arrays; later versions do not know it."""
COMPILED_ONCE: dict[str, bool | int] = {"xla_backend_optimization_level": 0} | OLDER_EMITTERS
"""Options of programs that run once or a few times."""
COMPILED_FOR_TICKS = COMPILED_FOR_FIRST_CALL | OLDER_EMITTERS
"""Options of programs of small arrays that run in a loop."""
WARNS = "JAXGRASP_JAX_WARNING"
"""Environment variable that, set to 0, turns off the warning about an unmeasured version of JAX."""
_program_folder: Path | None = None
_traces_for_processor: ContextVar[bool] = ContextVar("traces_for_processor", default=False)
CompileNotice().start()


def use_cache(folder: str | os.PathLike | None = None) -> Path:
    """Keep compiled code in a folder, for this process and the next ones; the command line does so by itself.

    What is kept goes by the program itself, the versions and the machine, so it never has to be thrown away. This
    changes settings of JAX for the whole process, as it says, and only where it is called.

    Args:
        folder: made where it is not there yet; where not given, ``JAX_COMPILATION_CACHE_DIR`` if that is set, or
            ``jaxgrasp/jax`` in the user's folder for caches, the command line's own.

    Returns:
        The folder.

    Raises:
        OSError: where there can be no such folder.
    """
    path = Path(folder or os.environ.get("JAX_COMPILATION_CACHE_DIR") or _home() / "jaxgrasp" / "jax")
    path.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    # JAX looks for its folder at the first compilation, which may have been.
    compilation_cache.reset_cache()
    global _program_folder
    _program_folder = path
    return path


def program_folder() -> Path | None:
    """Return the folder of ``use_cache``, for programs that are found without tracing; None where none is kept."""
    is_enabled, folder = jax_settings("jax_enable_compilation_cache", "jax_compilation_cache_dir")
    return _program_folder if is_enabled and folder == str(_program_folder) else None


def jax_settings(*names: str) -> tuple[Any, ...]:
    """Return the values of settings of JAX, as they are in this thread."""
    return tuple(getattr(jax.config, name) for name in names)


def _home() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def compile_all_quickly() -> None:
    """Have this process compile all of its programs quickly, to code several times as slow.

    It is said in ``XLA_FLAGS``, which XLA reads before its first program; what the user says there stays. Where JAX has
    plugins, which bring other processors than these, nothing is changed.
    """
    if "XLA_FLAGS" not in os.environ and not entry_points(group="jax_plugins"):
        os.environ["XLA_FLAGS"] = " ".join(f"--{name}={int(value)}" for name, value in COMPILED_ONCE.items())


@cache
def is_known_xla() -> bool:
    """Return whether programs are compiled for the processor, by a version of JAX that was measured here.

    Warns once, at the first use, where the version is newer than those: programs then compile without what makes it
    faster, to the same answers but for rounding.
    """
    if jax.default_backend() != "cpu":
        return False
    if jax.__version_info__ >= UNMEASURED_FROM and os.environ.get(WARNS) != "0":
        newest = ".".join(map(str, (UNMEASURED_FROM[0], UNMEASURED_FROM[1] - 1)))
        warnings.warn(
            f"JAX {jax.__version__} is newer than {newest}, the newest that jaxgrasp is tested with: first calls may "
            f"compile up to twice as long (answers are the same); {WARNS}=0 turns this warning off",
            RuntimeWarning,
            stacklevel=2,
        )
    return MEASURED_SINCE <= jax.__version_info__ < UNMEASURED_FROM


@cache
def merges_loops() -> bool:
    """Return whether XLA makes one kernel of a whole loop, so that what is in it need not be marked as one."""
    return is_known_xla() and jax.__version_info__ >= LOOPS_MERGED_FROM


def _compile_options(options: Mapping[str, bool | int]) -> dict[str, bool | int] | None:
    """Return those of XLA's ``options`` that the user has not set in ``XLA_FLAGS``; None off the processor."""
    if jax.default_backend() != "cpu":
        return None
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


def compile_quickly_options() -> dict[str, bool | int] | None:
    """Return options for programs that run once or a few times: compiled in a third to a half of the time, to code
    several times as slow.
    """
    return _compile_options(COMPILED_ONCE)


def padded_size(count: int, sizes: Sequence[int]) -> int:
    """Return the size that ``count`` entries are padded to, so that few shapes are compiled.

    It is the least of the ascending ``sizes`` that holds them; beyond the largest, a multiple of it.
    """
    position = bisect_left(sizes, count)
    return sizes[position] if position < len(sizes) else -(-count // sizes[-1]) * sizes[-1]


def jit_here(
    function: Callable, compiled_for: Mapping[str, bool | int] = COMPILED_FOR_FIRST_CALL, **options: Any
) -> jax.stages.Wrapped:
    """Compile a program that runs where JAX computes by default, as ``jax.jit`` does, in two thirds of the time.

    Where that is the processor, what differs between platforms is traced for it alone, in half the time. A user's
    own program may yet be lowered for another.
    """
    return jax.jit(traced_for_here(function), compiler_options=_compile_options(compiled_for), **options)


@cache
def jit_quickly(function: Callable, *static_argnames: str) -> jax.stages.Wrapped:
    """Compile a function, jitted or not, for a few calls where JAX computes by default: ``compile_quickly_options``.

    JAX refuses it inside other programs. The same function has the same program each time.
    """
    traced = traced_for_here(inspect.unwrap(function))
    return jax.jit(traced, static_argnames=static_argnames, compiler_options=compile_quickly_options())


def traced_for_here(function: Callable) -> Callable[..., Any]:
    """Return the function, which may be traced for JAX's default platform alone."""

    # Always another function than the one given, whose trace JAX would keep for programs of all platforms.
    @wraps(function)
    def traced(*args: Any, **kwargs: Any) -> Any:
        token = _traces_for_processor.set(jax.default_backend() == "cpu")
        try:
            return function(*args, **kwargs)
        finally:
            _traces_for_processor.reset(token)

    return traced


def is_tracing() -> bool:
    """Return whether this call is part of a program that is being traced, whatever its arguments are."""
    return isinstance(jnp.zeros(()), jax.core.Tracer)


def traces_for_processor() -> bool:
    """Return whether the program being traced is for the processor alone."""
    return _traces_for_processor.get()
