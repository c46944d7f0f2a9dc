"""A terminal beside this program's own: the screen of the person who is asked, while another sees what is rendered."""

import os
import sys
import time

from jaxgrasp.cli.experiment_arguments import Screen
from jaxgrasp.cli.terminal import CLEARED, Terminal, forget_typed_ahead, show
from jaxgrasp.files.printable import printable_lines

LONGEST = 4096
"""Bytes of a line that a terminal hands over at most."""


class OtherTerminal(Terminal):
    """A terminal of the same machine by its device, such as ``/dev/pts/3`` (Linux, macOS)."""

    def __init__(self, path: str) -> None:
        """Open the terminal's device.

        Raises:
            OSError: for a path that cannot be opened, or is no terminal.
        """
        # It must not become the one that could interrupt this program.
        self._number = os.open(path, os.O_RDWR | getattr(os, "O_NOCTTY", 0))
        if not os.isatty(self._number):
            os.close(self._number)
            raise OSError(f"{path} is not a terminal: expected the path that `jaxgrasp experiment screen` prints")

    def show(self, text: str) -> None:
        self._put(printable_lines(text) + "\n")

    def typed(self, prompt: str) -> str:
        forget_typed_ahead(self._number)
        self._put(prompt)
        try:
            line = os.read(self._number, LONGEST)
        except OSError:
            # Its window was closed.
            line = b""
        if not line:
            raise KeyboardInterrupt
        return line.decode(errors="replace").rstrip("\n")

    def clear(self) -> None:
        self._put(CLEARED)

    def close(self) -> None:
        """Close the terminal's device."""
        os.close(self._number)

    def _put(self, text: str) -> None:
        os.write(self._number, text.encode())


def screen_command(arguments: Screen) -> int:
    """Say which terminal this is, and leave its keyboard alone, until interrupted."""
    if os.name != "posix" or not sys.stdin.isatty():
        raise ValueError("another program cannot use this terminal: expected a terminal of Linux or macOS")
    show(
        f"This terminal is the person's. In another one: jaxgrasp experiment run ... --screen {os.ttyname(0)}\n"
        "It waits for that; Ctrl-C ends it."
    )
    while True:
        time.sleep(3600)
