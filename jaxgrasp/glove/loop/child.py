"""Worker process that takes orders and reports events as lines of JSON."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

PATIENCE = 15.0
"""Longest time for a program to start, to answer or to end [s]."""
MAX_MESSAGES = 1000
"""Number of recent messages of a program that are kept, so that memory stays bounded."""


def tell(message: dict[str, Any]) -> None:
    """Write a message as a line of JSON to standard output, for the process that started this one."""
    try:
        sys.stdout.write(json.dumps(message) + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever started it is dead; neither this nor the end of the program is to complain over a person's prompt.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class WorkerProcess:
    """Worker process: spawned, never forked; it ends when its standard input closes."""

    def __init__(self, module: str, options: dict[str, Any]) -> None:
        """Start a program.

        Args:
            module: run as ``python -m``.
            options: its only argument, as JSON.
        """
        self.messages: deque[dict[str, Any]] = deque(maxlen=MAX_MESSAGES)
        """Most recent messages of the program."""
        self.count = 0
        """Number of messages so far."""
        self._arrival = threading.Condition()
        command = [sys.executable, "-m", module, json.dumps(options)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._name = module.rpartition(".")[2]
        self._reader = threading.Thread(target=self._listen, daemon=True)
        self._reader.start()

    def order(self, message: dict[str, Any]) -> None:
        """Send an order to the program as a line of JSON.

        Raises:
            OSError: if it has ended.
        """
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(message) + "\n")
        self.process.stdin.flush()

    def wait_for(
        self, matches: Callable[[dict[str, Any]], bool], start: int = 0, patience: float = PATIENCE
    ) -> dict[str, Any]:
        """Wait for the first message from number ``begin`` on for which ``is_it`` is true, and return it.

        Raises:
            OSError: if it ends without, or takes too long.
        """
        end = time.perf_counter() + patience
        with self._arrival:
            while True:
                n_new = min(self.count - start, len(self.messages))
                answer = next(
                    (message for message in list(self.messages)[len(self.messages) - n_new :] if matches(message)), None
                )
                if answer is not None:
                    return answer
                start = self.count
                if not self._reader.is_alive():
                    raise OSError(f"{self._name} ended with {self.process.wait(PATIENCE)}")
                if time.perf_counter() > end:
                    raise OSError(f"{self._name} did not answer in {patience:.0f} s")
                self._arrival.wait(0.1)

    def close(self) -> int:
        """End the program and return its exit status; a program that does not end in time is killed."""
        assert self.process.stdin is not None and self.process.stdout is not None
        # What was still to be told finds nobody, if it has ended already.
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        try:
            self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join()
        self.process.stdout.close()
        return self.process.returncode

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            try:
                message = json.loads(line)
            except ValueError:
                # The last line of one that was killed may be half a line.
                continue
            with self._arrival:
                self.messages.append(message)
                self.count += 1
                self._arrival.notify_all()
