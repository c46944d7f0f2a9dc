"""``jaxgrasp glove``: what a person types at a glove's bench, on a simulated one."""

import contextlib
import os
import queue
import re
import socket
import subprocess
import sys
import threading
import time
import urllib.request

import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.files.replace import locked
from jaxgrasp.glove.line import SerialLine
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.sensors import Encoders, load_sensors

COMMAND = [sys.executable, "-m", "jaxgrasp.cli.main", "glove"]
POSIX = pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals")
JOINTS = lrp_hand_master().joints


def pairs(path, sensor: str = "encoder", **change) -> None:
    encoders, rng = Encoders(np.linspace(-0.1, 0.1, 14), np.full(14, 4e-4)), np.random.default_rng(0)
    lines = ["sensor,channel,counts,value"]
    for angles in rng.uniform(0, 1.5, (6, 14)):
        for joint, counts, angle in zip(JOINTS, encoders.counts(angles), angles):
            row = {"sensor": sensor, "channel": joint, "counts": str(counts), "value": f"{angle:.5f}", **change}
            lines.append(",".join(row.values()))
    path.write_text("\n".join(lines) + "\n")


def test_calibrate(folder, capsys):
    pairs(folder / "pairs.csv")
    assert main(["glove", "calibrate", "pairs.csv"]) == 0
    output = capsys.readouterr().out
    assert "encoders: residuals" in output and "no pairs of a gauge: its nominal calibration stays" in output
    sensors = load_sensors(folder / "calibration.json", 14)
    np.testing.assert_allclose(sensors.encoders.zero, np.linspace(-0.1, 0.1, 14), atol=1e-3)
    assert (folder / "calibration.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "change, message",
    [
        ({"sensor": "thermometer"}, "line 2: sensor is 'thermometer': expected encoder or gauge"),
        ({"channel": "thumb"}, "line 2: channel is 'thumb': expected one of thumb MP"),
        ({"counts": "x"}, "line 2: counts is 'x': expected a number"),
        ({"counts": "1_0"}, "line 2: counts is '1_0': expected a number"),
        ({"counts": "1.5"}, "line 2: counts is 1.5: expected a whole number"),
        ({"counts": "9" * 20}, "line 2: counts is 1e+20: expected a number up to 2.14748e+09"),
        ({"value": "nan"}, "line 2: value is nan: expected a number up to 1e+06"),
        ({"value": "1"}, "channel 0 does not change"),
    ],
)
def test_bad_pairs(folder, capsys, change, message):
    pairs(folder / "pairs.csv", **change)
    assert main(["glove", "calibrate", "pairs.csv"]) == 1
    assert message in capsys.readouterr().err and not (folder / "calibration.json").exists()


def test_bad_arguments(folder, capsys):
    (folder / "there").write_text("")
    (folder / "bad.key").write_text("x")
    (folder / "bad.key").chmod(0o600)
    for arguments, message in (
        (["simulate", "--port", "there"], "port is there: expected a name that does not exist yet"),
        (["simulate", "--port", "nowhere/glove"], "port is nowhere/glove: there is no folder"),
        (["simulate", "--baud", "0"], "baud is 0"),
        (["monitor", "--port", "nowhere"], "port nowhere cannot be opened: No such file"),
        (["monitor", "--model", "no.toml"], "no.toml"),
        (["run", "--listen", "x:1"], "listen needs the port"),
        (["run", "--port", "p", "--listen", "x"], "listen is 'x': expected HOST:PORT"),
        (["run", "--port", "p", "--connect", "x:1"], "--port and --connect were both given"),
        (["run", "--connect", "x"], "connect is 'x': expected HOST:PORT"),
        (["run", "--connect", "x:1", "--key-file", "bad.key"], "key file bad.key is not hexadecimal"),
        (["run", "--port", "nowhere", "--rate", "40"], "rate is 40: expected at least 50 [Hz], since a glove lets go"),
        (["run", "--port", "nowhere"], "port nowhere cannot be opened: No such file"),
        (["run", "--device", "openxr", "--connect", "x:1"], "OpenXR hand tracking has 19 channels, too many for a"),
        (
            ["monitor", "--device", "doglove", "--port", "p"],
            "joints_from is None for the device doglove: expected a port",
        ),
        (
            ["monitor", "--port", "p", "--joints-from", "q"],
            "joints_from is q for the device native: expected a port for",
        ),
        (["monitor", "--linkage"], "linkage is for the device doglove: expected none for the device native"),
        (
            ["monitor", "--device", "doglove", "--joints-from", "q", "--linkage", "--publish", "right"],
            "publish takes the joints of a human hand",
        ),
        (["monitor", "--device", "openxr", "--port", "udp:1"], "port is 'udp:1': expected udp:HOST:PORT"),
        (["run", "--connect", "x:1", "--tracker", "nowhere"], "port nowhere cannot be opened"),
        (["run", "--alignment", "there"], "alignment needs the port of a glove"),
        (["run", "--host", "0.0.0.0"], "host is 0.0.0.0, for the page of --view: add --view"),
    ):
        assert main(["glove", *arguments]) == 1
        assert message in capsys.readouterr().err, arguments


def test_ports(capsys):
    assert main(["glove", "ports"]) == 0 and capsys.readouterr().out


@POSIX
def test_simulate_and_monitor(folder):
    with subprocess.Popen([*COMMAND, "simulate", "--bend", "40", "--seconds", "6"], stdout=subprocess.PIPE) as glove:
        assert b"waits at jaxgrasp-glove" in glove.stdout.readline()
        done = subprocess.run([*COMMAND, "monitor", "--seconds", "2"], capture_output=True, text=True, check=True)
        glove.terminate()
    # On a busy machine the device may not have answered yet when the first lines are due.
    lines = [line for line in done.stdout.splitlines() if not line.endswith("the device does not answer")]
    assert len(lines) > 10 and "ms old" in lines[-2] and "[mN\N{MIDDLE DOT}m]" in lines[-1]
    assert "tMP" in lines[1] and "rPIP" in lines[1] and max(map(len, lines[1:])) < 100, "a screen of 100 columns"


@POSIX
def test_a_port_that_another_program_has(capsys):
    ours, theirs = os.openpty()
    line = SerialLine(os.ttyname(theirs), 115_200)
    try:
        assert main(["glove", "run", "--port", line.port]) == 1
        assert f"port {line.port} cannot be opened: another program has it" in capsys.readouterr().err
    finally:
        line.close()
        os.close(ours)
        os.close(theirs)


@POSIX
def test_what_a_killed_simulated_glove_left_is_taken_over_and_a_living_one_is_not(folder, capsys):
    (folder / "old").symlink_to("/dev/pts/99999")
    assert main(["glove", "simulate", "--port", "old", "--seconds", "0.1"]) == 0
    assert "a simulated glove waits at old" in capsys.readouterr().out and not list(folder.iterdir())
    with locked(folder, part="new"):
        assert main(["glove", "simulate", "--port", "new", "--seconds", "0.1"]) == 1
    assert "port is new, which another simulated glove uses: process" in capsys.readouterr().err


class Bench:
    """Someone at a glove's bench, who types orders and reads the answers."""

    NOTICES = ("torque is zero: ", "the glove is gone: ", "the glove answers again", "the glove gives less ")
    """How lines begin that answer no order."""
    PATIENCE = 300.0
    """Time [s] after which a line that did not come is a failure, with what had been printed until then."""

    def __init__(self, *arguments: str, command: tuple[str, ...] = ("glove", "run")):
        command = [*COMMAND[:-1], *command, *arguments]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._printed: list[str] = []
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._printed.append(line)
            self._lines.put(line)
        self._lines.put("")

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_) -> None:
        """End the process and close its pipes, whatever failed, so that none is left to later tests."""
        self.process.kill()
        self._reader.join()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        self.process.wait()

    def line(self) -> str:
        """Return the next line.

        Raises:
            AssertionError: if none comes, or the process has ended.
        """
        try:
            line = self._lines.get(timeout=self.PATIENCE)
        except queue.Empty:
            raise AssertionError(f"nothing more for {self.PATIENCE} s after {''.join(self._printed)}") from None
        assert line, f"ended with {self.process.wait(self.PATIENCE)} after {''.join(self._printed)}"
        return line

    def answer(self, order: str) -> str:
        """Send an order and return the reply, skipping what the glove says meanwhile by itself."""
        self.process.stdin.write(order + "\n")
        self.process.stdin.flush()
        while (line := self.line()).startswith(self.NOTICES):
            pass
        return line

    def insist(self, order: str) -> None:
        """Repeat an order until the glove gives all of its torque.

        Right after the start, or on a busy machine, there may be no fresh law; and a glove that let go since it was
        armed has to be armed and felt again.
        """
        for _ in range(40):
            answer = self.answer(order)
            if "of the torque" in answer:
                return
            if order == "full" and "arm, feel it, and then say full" in answer:
                self.answer("arm")
            time.sleep(0.5)
        raise AssertionError(answer)

    def leave(self) -> str:
        """Type the last order, and return what is printed from then on."""
        before = len(self._printed)
        self.process.stdin.write("quit\n")
        self.process.stdin.close()
        assert self.process.wait(self.PATIENCE) == 0, self._printed
        self._reader.join()
        return "".join(self._printed[before:])


@pytest.fixture
def bending(folder):
    """Yield the port of a simulated glove whose person opens and closes the hand."""
    with subprocess.Popen([*COMMAND, "simulate", "--bend", "60", "--seconds", "400"], stdout=subprocess.PIPE) as glove:
        glove.stdout.readline()
        yield "jaxgrasp-glove"
        glove.terminate()


@POSIX
def test_monitor_lucidgloves(folder, capsys):
    """Each line is answered, with fingers free: the firmware waits for that."""
    ours, theirs = os.openpty()
    pytest.importorskip("tty").setraw(theirs)
    (folder / "port").symlink_to(os.ttyname(theirs))

    def monitor(line: bytes) -> int:
        # An opened port forgets what came before.
        speaks = threading.Timer(0.4, os.write, (ours, line))
        speaks.start()
        options = ["--device", "lucidgloves", "--port", "port", "--full-scale", "4092", "--seconds", "1"]
        code = main(["glove", "monitor", *options])
        speaks.join()
        return code

    assert monitor(b"A0B1023C2046D3069E4092LJ\nnoise\n") == 0
    output = capsys.readouterr().out
    assert "channels: thumb MP, index" in output and "0   22   45   68   90" in output and "A, grab" in output
    assert b"A0B0C0D0E0\n" in os.read(ours, 4096)
    assert monitor(b"A0B1023C2046D3069E4093\n") == 1
    assert "1 lines arrived, none with five curls up to 4092" in capsys.readouterr().err
    os.close(ours)
    os.close(theirs)


@POSIX
@pytest.mark.slow
@pytest.mark.realtime
def test_run_now(bending):
    with Bench("--port", bending) as bench:
        assert "ready" in bench.line()
        assert "the first time power is on, it is a twentieth" in bench.answer("full")
        assert "is no order" in bench.answer("hello")
        bench.insist("arm")
        bench.insist("full")
        assert bench.answer("disarm") == "no torque\n"
        output = bench.leave()
    assert "the line: " in output and "the engine: " in output and "overruns" in output


@POSIX
@pytest.mark.slow
@pytest.mark.realtime
def test_several_objects_are_felt_and_seen(bending):
    """A ball on two blocks, with its page open: the loop goes on beside it, and the page answers."""
    pytest.importorskip("viser")
    with Bench("stack", "--port", bending, "--view", "--view-port", "0") as bench:
        page = re.search(r"http://\S+", bench.line())
        assert page and "ready" in bench.line()
        bench.insist("arm")
        with urllib.request.urlopen(page[0], timeout=20) as answer:
            assert answer.status == 200 and b"<html" in answer.read()
        bench.insist("full")
        assert bench.answer("disarm") == "no torque\n"
        output = bench.leave()
    assert "the line: " in output and "the engine: " in output


@POSIX
@pytest.mark.slow
@pytest.mark.always
@pytest.mark.realtime
def test_a_glove_that_dies_is_told_at_once_and_armed_anew_from_a_twentieth(folder):
    """A person at the bench who types nothing is told at once that the glove has died, and can arm it anew."""
    glove = [*COMMAND, "simulate", "--bend", "60"]
    with contextlib.ExitStack() as opened:
        first = opened.enter_context(subprocess.Popen(glove, stdout=subprocess.PIPE))
        opened.callback(first.kill)
        assert b"waits" in first.stdout.readline()
        bench = opened.enter_context(Bench("--port", "jaxgrasp-glove"))
        assert "ready" in bench.line()
        bench.insist("arm")
        bench.insist("full")
        first.kill()
        killed = time.perf_counter()
        while (line := bench.line()).startswith("the glove gives less "):
            pass
        assert "torque is zero" in line and time.perf_counter() - killed < 1.0, "on a busy machine"
        assert "type arm" in line
        while "gone" not in line and "reconnect" not in line:
            line = bench.line()
        second = opened.enter_context(subprocess.Popen(glove, stdout=subprocess.PIPE))
        opened.callback(second.kill)
        assert b"waits" in second.stdout.readline(), "what the first left behind is no obstacle"
        while "answers again" not in line:
            line = bench.line()
        assert "the first time power is on, it is a twentieth" in bench.answer("full")
        bench.insist("arm")
        assert bench.answer("disarm") == "no torque\n"
        assert "the first time power is on, it is a twentieth" in bench.answer("full")
        output = bench.leave()
    assert re.search(r"the glove let go by itself: \d+ times: .*\(\d+\)", output)


@POSIX
@pytest.mark.slow
@pytest.mark.realtime
def test_two_hosts(bending, folder):
    """The glove's host is called by an engine, and armed where the person is; both go on when either starts anew."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    (folder / "key").write_text(32 * "0f" + "\n")
    (folder / "key").chmod(0o600)
    keys = ("--key-file", "key")
    with contextlib.ExitStack() as opened:
        host = opened.enter_context(Bench("--port", bending, "--listen", address, *keys))
        assert address in host.line()
        assert "no torque law was given" in host.answer("arm")
        engine = opened.enter_context(Bench("--connect", address, "--seconds", "60", *keys))
        assert "calls" in engine.line()
        host.insist("arm")
        host.leave()
        again = opened.enter_context(Bench("--port", bending, "--listen", address, *keys))
        again.line()
        again.insist("arm")
        engine.process.terminate()
        engine.process.wait(engine.PATIENCE)
        time.sleep(0.2)
        assert "no torque law was given" in again.answer("arm")
        again.leave()
