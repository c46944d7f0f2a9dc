"""What commands show: text from files cannot move the cursor, colour the screen or ring the bell."""

import contextlib
import sys

from jaxgrasp.files.printable import printable_lines


def show(*texts: object) -> None:
    """Print, with control characters escaped; of text from a file the line breaks must have been escaped before."""
    print(printable_lines(" ".join(map(str, texts))), flush=True)


def announce(text: object) -> None:
    """A line on stderr: what is being done, since it may take a while, or what went wrong."""
    line = printable_lines(text)
    # Writes around the bar of progress, where there is one.
    if (bars := sys.modules.get("tqdm")) is not None:
        bars.tqdm.write(line, file=sys.stderr)
    else:
        print(line, file=sys.stderr, flush=True)


def typed(prompt: str) -> str:
    """A line from the keyboard; KeyboardInterrupt where there are no more."""
    if sys.stdin.isatty():
        with contextlib.suppress(ImportError):
            import termios

            # What was typed ahead answers nothing that was felt.
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
    try:
        return input(prompt)
    except EOFError:
        raise KeyboardInterrupt from None
