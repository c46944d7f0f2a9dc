"""Programs that are compiled once for each set of shapes, and read back by the next process.

JAX keeps compiled code in its own cache, but finds it by the traced program, so each process traces and lowers it anew:
for the optimum that is most of a first call. What ``use_cache`` was called for is found here by what it is traced from:
the package's own code, the shapes, the versions, the processor and JAX's settings.
"""

import hashlib
import logging
import os
import pickle
import platform
import sys
import threading
import time
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakSet

import jax
import jax.numpy as jnp
import jaxlib
from jax.experimental import serialize_executable

from jaxgrasp.files.replace import replace_file
from jaxgrasp.numerics.compiled_code import is_known_xla, jax_settings, jit_here, program_folder

TRACED_FROM = ("model", "numerics", "problem", "solver")
"""Subpackages of whose code these programs are made."""
PREFIXES = tuple(f"{__name__.partition('.')[0]}.{name}." for name in TRACED_FROM)
SUFFIX = ".program"
CACHE_HIT = "/jax/compilation_cache/cache_hits"
"""Event of JAX where it reads a program from its own cache."""
CHANGES_OF_TRACES = ("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion")
"""Settings of JAX on which a trace depends."""
CHANGES_OF_CALLS = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit", "jax_default_device")
"""Settings of JAX that change what a call does; with any of them no kept program is used."""
logger = logging.getLogger(__name__)
_programs: "WeakSet[Program]" = WeakSet()


class Program:
    """A function of positional trees of arrays, compiled once for each set of their shapes.

    Where ``use_cache`` was called, a function of a module, without a closure, is read from its folder or kept there.
    """

    def __init__(self, function: Callable, function_key: str | None = None) -> None:
        """Prepare a program; nothing is compiled yet.

        Args:
            function: of arrays.
            function_key: says what the function computes, to the next process too; None where it cannot be kept.
        """
        self._jitted = jit_here(function)
        self._function_key = function_key
        self._compiled: dict[tuple, Callable[..., Any]] = {}
        self._lock = threading.Lock()
        _programs.add(self)

    def __call__(self, *arguments: Any) -> Any:
        """Return what the function returns."""
        folder = self._folder()
        # `jit` finds its program in a tenth of the time that reading the shapes here takes.
        return self._jitted(*arguments) if folder is None else self.compiled(arguments)[0](*arguments)

    def compiled(self, arguments: tuple) -> tuple[Callable[..., Any], float]:
        """Return the program for arguments of these shapes, and the seconds of compiling or reading it.

        The seconds are 0 where it is known already.
        """
        key = _shape_key(arguments)
        with self._lock:
            if key in self._compiled:
                return self._compiled[key], 0.0
            start = time.perf_counter()
            self._compiled[key] = self._read_or_compile(key, arguments)
            return self._compiled[key], time.perf_counter() - start

    def is_compiled_for(self, arguments: tuple) -> bool:
        """Return whether ``compiled`` was called for arguments of these shapes."""
        return _shape_key(arguments) in self._compiled

    def _folder(self) -> Path | None:
        return program_folder() if self._function_key is not None and _is_plain_setting() else None

    def _read_or_compile(self, key: tuple, arguments: tuple) -> Callable[..., Any]:
        folder = self._folder()
        if folder is None:
            return self._jitted.lower(*arguments).compile()
        path = folder / (_file_key(f"{self._function_key} {key}") + SUFFIX)
        program = _read(path, arguments)
        if program is not None:
            return program
        with _CacheHits() as hits:
            program = self._jitted.lower(*arguments).compile()
        # What JAX has read from its own cache cannot be written again: it would miss its functions.
        if not hits.count:
            _write(path, program)
        return program


class _CacheHits:
    """Count of the programs that this thread reads from JAX's own cache within a ``with`` statement."""

    def __enter__(self) -> "_CacheHits":
        self.count, self._thread = 0, threading.get_ident()
        jax.monitoring.register_event_listener(self._on_event)
        return self

    def __exit__(self, *_: object) -> None:
        jax.monitoring.unregister_event_listener(self._on_event)

    def _on_event(self, event: str, **_: str | int) -> None:
        self.count += event == CACHE_HIT and threading.get_ident() == self._thread


def clear_programs() -> None:
    """Drop the compiled code of all programs of this process, as ``jax.clear_caches`` does for other functions."""
    for program in list(_programs):
        program._compiled.clear()


def key_of(*parts: Any) -> str | None:
    """Return a key of functions and plain values; None where a function is not one of a module of this package.

    A callable object has the key of its ``function_key``.
    """
    words = [_word(part) for part in parts]
    known = [word for word in words if word is not None]
    return " ".join(known) if len(known) == len(words) else None


def _word(part: Any) -> str | None:
    if not callable(part):
        return repr(part)
    if hasattr(part, "function_key"):
        return part.function_key
    name = f"{getattr(part, '__module__', '')}.{getattr(part, '__qualname__', '<>')}"
    return name if name.startswith(PREFIXES) and "<" not in name else None


def _shape_key(arguments: tuple) -> tuple:
    """Return what a trace depends on: structure, shapes, dtypes and weak types of arguments, and settings of JAX."""
    leaves, structure = jax.tree.flatten(arguments)
    # Not `isinstance`: NumPy's float64 is a float, too.
    kinds = [
        (jnp.result_type(leaf), True)
        if type(leaf) in (bool, int, float, complex)
        else (leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False))
        for leaf in leaves
    ]
    return structure, *kinds, *jax_settings(*CHANGES_OF_TRACES)


def _is_plain_setting() -> bool:
    """Return whether none of JAX's settings that change what a call does is on, so that a kept program does as well."""
    return is_known_xla() and jax.local_device_count() == 1 and not any(jax_settings(*CHANGES_OF_CALLS))


@cache
def _environment() -> str:
    """Return what compiled code depends on beside its program: versions, code, processor and flags of XLA."""
    folder = Path(__file__).parents[1]
    code = hashlib.sha256()
    for path in sorted(path for name in TRACED_FROM for path in (folder / name).rglob("*.py")):
        code.update(f"{path.relative_to(folder).as_posix()} {path.stat().st_size}\n".encode() + path.read_bytes())
    versions = (sys.version, jax.__version__, jaxlib.__version__, os.environ.get("XLA_FLAGS", ""))
    return repr((code.hexdigest(), versions, platform.machine(), platform.processor(), _processor_features()))


def _processor_features() -> list[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
    except OSError:
        return []
    return [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU "))]


def _file_key(program_key: str) -> str:
    text = f"{_environment()} {jax_settings(*CHANGES_OF_TRACES)} {program_key}"
    return hashlib.sha256(text.encode()).hexdigest()


def _read(path: Path, arguments: tuple) -> Callable[..., Any] | None:
    """Return the program of a file; None where there is none that can be read."""
    if not path.exists():
        return None
    try:
        executable, example = pickle.loads(zlib.decompress(path.read_bytes()))
        argument_tree = jax.tree.structure((arguments, {}))
        return serialize_executable.deserialize_and_load(executable, argument_tree, jax.tree.structure(example))
    except Exception as error:
        # Half a file, or another version's: the program is compiled again, and the file replaced.
        logger.info("%s is not read: %s", path, error)
        return None


def _write(path: Path, program: Any) -> None:
    """Keep a program in a file, whole or not at all."""
    try:
        executable, _, tree = serialize_executable.serialize(program)
        # A structure of a package's own classes is no bytes; a tree of numbers in its place is.
        data = zlib.compress(pickle.dumps((executable, jax.tree.unflatten(tree, range(tree.num_leaves)))), 1)
        replace_file(path, lambda stream: stream.write(data))
    except Exception as error:
        # A full disk, or a program that cannot be kept: it is there for this process.
        logger.info("%s is not kept: %s", path, error)
