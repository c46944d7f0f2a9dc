"""Lines that a person or a pipe types: each whole, in order, and no question that nothing can end."""

import os
import subprocess
import sys
import time

import pytest

from jaxgrasp.cli.terminal import LineInput, read_until, wait_until

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs descriptors that can be waited for")


@pytest.fixture
def pipe():
    theirs, ours = os.pipe()
    yield LineInput(theirs), ours
    os.close(theirs)
    os.close(ours)


def test_lines_come_whole_and_in_order(pipe):
    lines, ours = pipe
    assert lines.read(0.0) is None
    os.write(ours, "first\nsecond\r\nunfin\N{LATIN SMALL LETTER E WITH ACUTE}".encode()[:-1])
    assert [lines.read(0.0) for _ in range(3)] == ["first", "second", None]
    os.write(ours, b"\xa9shed\n\n")
    assert [lines.read(0.0) for _ in range(3)] == ["unfin\N{LATIN SMALL LETTER E WITH ACUTE}shed", "", None]


def test_the_end_of_the_input_interrupts_after_its_last_line():
    theirs, ours = os.pipe()
    os.write(ours, b"last")
    os.close(ours)
    lines = LineInput(theirs)
    assert lines.read(1.0) == "last"
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            lines.read(1.0)
    os.close(theirs)


def test_a_question_and_a_wait_end_when_they_are_over(pipe):
    lines, ours = pipe
    for ends in (lambda over: read_until(lines, over), lambda over: wait_until(60.0, over, lines)):
        started = time.perf_counter()
        assert ends(lambda started=started: time.perf_counter() > started + 0.1) is None
        assert 0.1 <= time.perf_counter() - started < 0.3
    os.write(ours, b"stop\n")
    assert wait_until(60.0, lambda: False, lines) == "stop"
    started = time.perf_counter()
    assert wait_until(0.1, lambda: False, lines) is None and 0.1 <= time.perf_counter() - started < 0.3


def test_a_program_ends_while_nobody_types():
    """A thread that waits for an order must not hold up, or break, the end of the program."""
    program = (
        "import threading\nfrom jaxgrasp.cli.terminal import typed\n"
        "threading.Thread(target=lambda: typed('order: '), daemon=True).start()\nprint('over')"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.wait(60) == 0
        assert process.stdout.read().endswith(b"over\n")
