"""Text output and input of commands: text from files cannot move the cursor, colour the screen or ring the bell."""

import contextlib
import os
import select
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any

from jaxgrasp.files.printable import printable_lines

STANDARD_OUTPUT = "standard output"
CLEARED = "\x1b[2J\x1b[3J\x1b[H"
"""Erases a screen and what scrolled off it, and goes to its first line."""


def show(*texts: object) -> None:
    """Print, with control characters escaped; of text from a file the line breaks must have been escaped before."""
    _write(" ".join(map(str, texts)), sys.stdout)


def announce(text: object) -> None:
    """Print a line on stderr, about slow work in progress or an error."""
    _write(text, sys.stderr)


def _write(text: object, stream: Any) -> None:
    """Write a line, around the bar of progress, where there is one."""
    line = printable_lines(text)
    try:
        if (bars := sys.modules.get("tqdm")) is not None:
            bars.tqdm.write(line, file=stream)
            stream.flush()
        else:
            print(line, file=stream, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        # Of a full device the system names no file.
        raise OSError(error.errno, error.strerror, STANDARD_OUTPUT if stream is sys.stdout else "stderr") from error


def forget_typed_ahead(stream: Any) -> None:
    """Discard input typed before the question, where the system has terminals (termios)."""
    with contextlib.suppress(ImportError):
        import termios

        termios.tcflush(stream, termios.TCIFLUSH)


LOOKS_EVERY = 0.05
"""Time between two looks at what may end a question [s]."""
READ_SIZE = 4096
"""Largest number of bytes read at once; a terminal hands over at most as many of a line."""


class LineInput:
    """Lines from a file descriptor of a terminal or a pipe, read without a wait that nothing can end (POSIX)."""

    def __init__(self, descriptor: int) -> None:
        """Create a reader that has read nothing."""
        self._descriptor = descriptor
        self._incomplete = b""
        self._has_ended = False

    def read(self, timeout_s: float) -> str | None:
        """Return the next line without its end; None if there is no whole line within ``timeout_s`` [s].

        Raises:
            KeyboardInterrupt: at the end of the input.
        """
        end = time.perf_counter() + timeout_s
        while b"\n" not in self._incomplete and not self._has_ended:
            remaining_s = max(0.0, end - time.perf_counter())
            if not select.select([self._descriptor], [], [], remaining_s)[0]:
                return None
            try:
                data = os.read(self._descriptor, READ_SIZE)
            except OSError:
                # The window of the terminal was closed.
                data = b""
            self._has_ended = not data
            self._incomplete += data
        if not self._incomplete:
            raise KeyboardInterrupt
        line, _, self._incomplete = self._incomplete.partition(b"\n")
        return line.rstrip(b"\r").decode(errors="replace")

    def forget_typed_ahead(self) -> None:
        """Discard input that was typed before a question, where a person types it at a terminal."""
        if os.isatty(self._descriptor):
            forget_typed_ahead(self._descriptor)
            self._incomplete = b""


def standard_lines() -> LineInput | None:
    """Return the reader of the standard input; None where it has no descriptor that can be waited for."""
    try:
        descriptor = sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):
        return None
    return None if os.name != "posix" else _standard_lines(descriptor)


@cache
def _standard_lines(descriptor: int) -> LineInput:
    return LineInput(descriptor)


def typed(prompt: str, is_over: Callable[[], bool] | None = None) -> str | None:
    """Read a line from the keyboard.

    Args:
        prompt: printed before it.
        is_over: ends the question when it returns True; asked for every ``LOOKS_EVERY`` seconds where the input is a
            terminal or a pipe (POSIX), and not at all elsewhere.

    Returns:
        The line; None where the question was over before.

    Raises:
        KeyboardInterrupt: at the end of the input.
    """
    lines = standard_lines()
    if lines is None:
        try:
            return input(prompt)
        except EOFError:
            raise KeyboardInterrupt from None
    lines.forget_typed_ahead()
    print(prompt, end="", flush=True)
    return read_until(lines, is_over)


def read_until(lines: LineInput, is_over: Callable[[], bool] | None) -> str | None:
    """Return the next line; None where ``is_over`` returned True before."""
    while (line := lines.read(LOOKS_EVERY)) is None:
        if is_over is not None and is_over():
            return None
    return line


def wait_until(seconds: float, is_over: Callable[[], bool], lines: LineInput | None = None) -> str | None:
    """Wait for ``seconds`` [s]; return the line that is typed meanwhile, or None where nothing is.

    Returns early when ``is_over`` returns True.
    """
    end = time.perf_counter() + seconds
    while (remaining_s := end - time.perf_counter()) > 0 and not is_over():
        step_s = min(remaining_s, LOOKS_EVERY)
        if lines is None:
            time.sleep(step_s)
        elif (line := lines.read(step_s)) is not None:
            return line
    return None


class Terminal(ABC):
    """Terminal at which a person reads and types."""

    @abstractmethod
    def show(self, text: str) -> None:
        """Show lines, with control characters escaped."""

    @abstractmethod
    def typed(self, prompt: str, is_over: Callable[[], bool] | None = None) -> str | None:
        """Read a line from the terminal's keyboard, or return None where ``is_over`` returned True before.

        Raises:
            KeyboardInterrupt: at the end of the input.
        """

    @abstractmethod
    def wait(self, seconds: float, is_over: Callable[[], bool]) -> str | None:
        """Wait for a time [s], or until ``is_over`` returns True or a line is typed, which is returned."""

    @abstractmethod
    def clear(self) -> None:
        """Clear the screen, where the output is a screen."""


class OwnTerminal(Terminal):
    """Terminal of this program: standard input and output."""

    def show(self, text: str) -> None:
        show(text)

    def typed(self, prompt: str, is_over: Callable[[], bool] | None = None) -> str | None:
        return typed(prompt, is_over)

    def wait(self, seconds: float, is_over: Callable[[], bool]) -> str | None:
        # What a pipe holds are the answers to come.
        return wait_until(seconds, is_over, standard_lines() if sys.stdin.isatty() else None)

    def clear(self) -> None:
        if sys.stdout.isatty():
            print(CLEARED, end="", flush=True)
