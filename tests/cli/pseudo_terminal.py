"""A person at a pseudo-terminal: reads the screen, and types when asked."""

import os
import select
import subprocess
import time
from collections.abc import Callable

LONGEST = 65536


class PersonAtTerminal:
    """Runs a command in a terminal of its own; a context manager, after which nothing of it is left."""

    def __init__(self, command: list[str]) -> None:
        """Start the command at a terminal of its own."""
        self.screen = ""
        self._seen = 0
        self._terminal, theirs = os.openpty()
        self._process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True)
        os.close(theirs)

    def __enter__(self) -> "PersonAtTerminal":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._terminal)

    def type(self, text: str) -> None:
        os.write(self._terminal, text.encode() + b"\n")

    def reads(self, text: str, patience: float = 60.0) -> str:
        """Return the output up to the text that is waited for; skip what came before the previous text."""
        end = time.perf_counter() + patience
        while text not in self.screen[self._seen :]:
            assert time.perf_counter() < end and self._more(), f"no {text!r} in:\n{self.screen[self._seen :]}"
        begin, self._seen = self._seen, self.screen.index(text, self._seen) + len(text)
        return self.screen[begin : self._seen]

    def plays(self, answers: dict[str, Callable[[], str]], patience: float = 120.0, stops: str = "") -> int:
        """Answer each prompt that stands last on the screen until the command ends, and say its exit code; 0 too where
        it goes on and the screen has what it ``stops`` at."""
        end = time.perf_counter() + patience
        while self._more():
            assert time.perf_counter() < end, self.screen[self._seen :]
            new = self.screen[self._seen :].rstrip(" ")
            if stops and stops in new:
                return 0
            for prompt, answer in answers.items():
                if new.endswith(prompt):
                    self._seen = len(self.screen)
                    self.type(answer())
                    break
        return self._process.wait()

    def _more(self) -> bool:
        """Wait a moment for more; False at the end of it all."""
        if not select.select([self._terminal], [], [], 0.05)[0]:
            return True
        try:
            came = os.read(self._terminal, LONGEST)
        except OSError:
            return False
        self.screen += came.decode(errors="replace")
        return bool(came)
