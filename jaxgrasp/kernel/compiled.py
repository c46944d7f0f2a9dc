"""The kernel compiled for this machine's processor by NVIDIA Warp, the extra ``kernel``.

Warp brings its own Clang and keeps what it compiles on disk: the first process of a machine waits for some seconds, the
next ones for a few milliseconds. One compiled variant serves batches of any size, and any number of contacts up to its
room.
"""

# Annotations of Warp's functions are values.
# mypy: disable-error-code="valid-type"

import logging
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from typing import Any, NamedTuple, no_type_check

import numpy as np

from jaxgrasp.files.stderr import redirected_stderr
from jaxgrasp.kernel import MISSING, include_folder
from jaxgrasp.validation.optional_library import optional_library

ROOMS = (8, 16, 32, 64, 128)
"""Largest numbers of contacts of the variants: little room for few contacts keeps the data in the cache."""
INPUTS = (
    *("points", "normals", "friction", "squeeze", "wrench", "weights", "present", "torsion"),
    *("normal_min", "normal_max", "start"),
)
"""Arrays of a batch in the order of ``Batch::inputs`` in batch.h, which are also fields of a ``ProblemBatch``."""
CODES = ("verdict", "steps", "route", "rank")
OUTPUTS = (
    *("forces", "multiplier", "residual", "objective", "certificate", "force_bound", "moments", "normal_multiplier"),
    *CODES,
)
"""Arrays of a solution in the order of ``SolutionArrays`` in batch.h."""
NO_DRIVER = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver"
"""Line that Warp prints on machines without a GPU, where it is no news."""
FLAGS = "-march=native -ffp-contract=fast"
"""Of Warp's Clang: this processor's instructions, and products and sums in one, as GCC has it unless told otherwise."""
WARP_HEADERS = include_folder() / "warp_headers"
"""Headers in place of Warp's of the same names."""
_lock = threading.RLock()


class Variant(NamedTuple):
    """A compiled form of the kernel."""

    dtype: str
    """``"float32"`` or ``"float64"``."""
    max_contacts: int
    has_soft_fingers: bool
    has_bounds: bool
    """Normal forces are bounded."""

    @property
    def template_arguments(self) -> str:
        """The arguments of the header's templates."""
        real = "double" if self.dtype == "float64" else "float"
        flags = ", ".join(str(flag).lower() for flag in (self.has_soft_fingers, self.has_bounds))
        return f"{real}, {self.max_contacts}, {flags}"

    @property
    def name(self) -> str:
        """Name of the variant, unique to it."""
        flags = ("_soft" if self.has_soft_fingers else "") + ("_bounded" if self.has_bounds else "")
        return f"jaxgrasp_{self.dtype}_{self.max_contacts}{flags}"


class Handlers(NamedTuple):
    """Handlers of XLA that are compiled together, as C++ with the variant's arguments of templates left out."""

    header: str
    functions: tuple[str, ...]


SOLVERS = Handlers("xla_call.h", ("solve<{}, false>", "solve<{}, true>"))
"""The optimum, or both solutions where there is room for both; and the closed form."""
PULLBACK = Handlers("xla_pullback.h", ("pull_back<{}>",))
"""Derivatives of an answer in reverse."""


def room_for(n_contacts: int) -> int | None:
    """Return the room of the variant for a number of contacts; None where no variant has so much."""
    return next((room for room in ROOMS if room >= n_contacts), None)


@cache
def addresses(variant: Variant, handlers: Handlers = SOLVERS) -> tuple[int, ...]:
    """Compile a variant, or load it from Warp's cache, and return the addresses of its functions in this process.

    Raises:
        ImportError: where the extra is not installed, with the pip command.
    """
    with _lock:
        published = _published(variant, handlers, with_whole_header=False)
        return published or _published(variant, handlers, with_whole_header=True)


def _published(variant: Variant, handlers: Handlers, with_whole_header: bool) -> tuple[int, ...]:
    """Return the addresses of a variant's functions; none where it does not compile without Warp's whole header."""
    warp = initialised_warp()
    kernel = _publisher(warp, variant, handlers, with_whole_header)
    published = np.zeros(len(handlers.functions), np.uint64)
    with quiet(warp.config), tempfile.TemporaryFile() as messages:
        try:
            with nullcontext() if with_whole_header else redirected_stderr(messages):
                warp.launch(kernel, dim=1, inputs=[published.ctypes.data], device="cpu")
        except Exception:
            # Warp raises nothing more specific where its compiler fails.
            if with_whole_header:
                raise
            return ()
    # The kernel belongs to the module of machine code that holds the functions.
    _loaded.append(kernel)
    return tuple(map(int, published))


_loaded: list[Any] = []


@no_type_check  # Warp reads the annotations of its functions, and their source.
def _publisher(warp: Any, variant: Variant, handlers: Handlers, with_whole_header: bool) -> Any:
    """Return a kernel of Warp that writes the addresses of a variant's functions to the address that it is given."""
    snippet = "unsigned long long* addresses = (unsigned long long*)destination;\n"
    for i, function in enumerate(handlers.functions):
        named = function.format(variant.template_arguments)
        snippet += f"addresses[{i}] = (unsigned long long)(void*)&jaxgrasp::xla::{named};\n"
    flags = FLAGS if with_whole_header else f"{FLAGS} -iquote {WARP_HEADERS}"

    @warp.func_native(snippet)
    def publish(destination: warp.uint64): ...  # type: ignore[name-defined]

    @warp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"extra_build_options": build_options(handlers.header), "cpu_compiler_flags": flags},
    )
    def publish_addresses(destination: warp.uint64):  # type: ignore[name-defined]
        publish(destination)

    return publish_addresses


def build_options(header: str) -> Any:
    """Return Warp's options that include one of the kernel's headers; a change of any header compiles anew."""
    folder = include_folder()
    include = f'#include "{header}"\n'
    return initialised_warp().ModuleBuildOptions(
        extra_cpu_include_dirs=[str(folder)],
        extra_cuda_include_dirs=[str(folder)],
        extra_cpu_preamble=include,
        extra_cuda_preamble=include,
        extra_build_dependencies=sorted(map(str, folder.rglob("*.h"))),
    )


@cache
def initialised_warp() -> Any:
    """Import and start Warp without the lines that it prints."""
    warp = optional_library("warp", missing=MISSING)
    with quiet(warp.config), _without_line(NO_DRIVER):
        warp.init()
    return warp


@contextmanager
def quiet(config: Any) -> Iterator[None]:
    """Have Warp print warnings only, and parse its headers without precompiling them, which pays from the third on."""
    before = config.log_level, config.use_precompiled_headers
    config.log_level, config.use_precompiled_headers = max(before[0], logging.WARNING), False
    try:
        yield
    finally:
        config.log_level, config.use_precompiled_headers = before


@contextmanager
def _without_line(start: bytes) -> Iterator[None]:
    """Leave out the line with this start from what C code prints to stderr meanwhile; other lines come afterwards."""
    with tempfile.TemporaryFile() as file:
        try:
            with redirected_stderr(file):
                yield
        finally:
            file.seek(0)
            rest = b"".join(line for line in file if not line.startswith(start))
            if rest:
                os.write(2, rest)
