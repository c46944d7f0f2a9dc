"""What commands show: text from files cannot move the cursor, colour the screen or ring the bell."""

import contextlib
import sys
from abc import ABC, abstractmethod
from typing import Any

from jaxgrasp.files.printable import printable_lines

STANDARD_OUTPUT = "standard output"
CLEARED = "\x1b[2J\x1b[3J\x1b[H"
"""Erases a screen and what scrolled off it, and goes to its first line."""


def show(*texts: object) -> None:
    """Print, with control characters escaped; of text from a file the line breaks must have been escaped before."""
    _write(" ".join(map(str, texts)), sys.stdout)


def announce(text: object) -> None:
    """A line on stderr: what is being done, since it may take a while, or what went wrong."""
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
    """What was typed before it was asked for answers nothing."""
    with contextlib.suppress(ImportError):
        import termios

        termios.tcflush(stream, termios.TCIFLUSH)


def typed(prompt: str) -> str:
    """A line from the keyboard; KeyboardInterrupt where there are no more."""
    if sys.stdin.isatty():
        forget_typed_ahead(sys.stdin)
    try:
        return input(prompt)
    except EOFError:
        raise KeyboardInterrupt from None


class Terminal(ABC):
    """Where a person reads and types."""

    @abstractmethod
    def show(self, text: str) -> None:
        """Lines, with control characters escaped."""

    @abstractmethod
    def typed(self, prompt: str) -> str:
        """A line from its keyboard; KeyboardInterrupt where there are no more."""

    @abstractmethod
    def clear(self) -> None:
        """Leave an empty screen, where it is one."""


class OwnTerminal(Terminal):
    """That of this program."""

    def show(self, text: str) -> None:
        show(text)

    def typed(self, prompt: str) -> str:
        return typed(prompt)

    def clear(self) -> None:
        if sys.stdout.isatty():
            print(CLEARED, end="", flush=True)
