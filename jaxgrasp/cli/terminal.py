"""Text output and input of commands: text from files cannot move the cursor, colour the screen or ring the bell."""

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


def typed(prompt: str) -> str:
    """Read a line from the keyboard; raise KeyboardInterrupt at the end of the input."""
    if sys.stdin.isatty():
        forget_typed_ahead(sys.stdin)
    try:
        return input(prompt)
    except EOFError:
        raise KeyboardInterrupt from None


class Terminal(ABC):
    """Terminal at which a person reads and types."""

    @abstractmethod
    def show(self, text: str) -> None:
        """Show lines, with control characters escaped."""

    @abstractmethod
    def typed(self, prompt: str) -> str:
        """Read a line from the terminal's keyboard; raise KeyboardInterrupt at the end of the input."""

    @abstractmethod
    def clear(self) -> None:
        """Clear the screen, where the output is a screen."""


class OwnTerminal(Terminal):
    """Terminal of this program: standard input and output."""

    def show(self, text: str) -> None:
        show(text)

    def typed(self, prompt: str) -> str:
        return typed(prompt)

    def clear(self) -> None:
        if sys.stdout.isatty():
            print(CLEARED, end="", flush=True)
