"""Streams of other gloves with 20 % faults: how many frames are spoilt, accepted, and accepted wrong.

    python -m tests.glove.fuzz --frames 1000000

The slow tests ask the same of fewer frames. Senders are the simulated ones of this folder, which share nothing with the
readers. The two encodings of LucidGloves have no check, and are measured for that reason alone.
"""

import argparse
import json
import math
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.model import lucidgloves
from jaxgrasp.glove.other_devices.doglove_board import BoardReader
from jaxgrasp.glove.other_devices.dynamixel import CONTROL, IDENTITY, ServoBus
from jaxgrasp.glove.other_devices.lucidgloves import read_line
from jaxgrasp.glove.other_devices.opengloves import OpenGlovesHost
from jaxgrasp.glove.other_devices.openxr import RecordReader, openxr
from jaxgrasp.glove.simulated.simulation import FaultInjector, MemoryLine
from tests.glove import simulated_doglove as published
from tests.glove import simulated_openxr as client

SHARE = 0.2
POSTURES = 50
FULL_FLEXION = {"thumb": 55 + 80, "finger": 90 + 100 + 90}
"""Sum of the flexions of a closed fist [degrees], from the documentation."""


class Count(NamedTuple):
    """Frames of a fuzzed stream."""

    faults: int
    accepted: int
    wrong: int
    """Accepted frames that hold other values than any that was sent."""


def drawn_angles(seed: int) -> dict[str, float]:
    """Draw the angles of a tracked hand [rad]."""
    rng = np.random.default_rng(seed)
    return {
        joint: float(rng.uniform(-0.3, 0.3) if "abduction" in joint else rng.uniform(-0.2, 1.6))
        for joint in openxr().joints
    }


def fuzz_board(frames: int, seed: int) -> Count:
    """Count frames of DOGlove's main board on a hand that moves."""
    board, reader, injector = published.Board(), BoardReader(), FaultInjector(SHARE, seed)
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.1, 3, 16), rng.uniform(0, 6, 16)
    recent: list[bytes] = []
    accepted = wrong = 0
    for k in range(frames):
        time = k * board.period
        swings = 40 * np.sin(math.tau * rates * time + phases)
        board.degrees = (180 + swings + rng.normal(0, 0.02, 16)).tolist()
        frame = board.frame(time)
        recent.append(frame[4:72])
        for read in reader.feed(injector.inject(frame)):
            accepted += 1
            # Of the last frames only: none may come later.
            wrong += read.words.astype("<u4", casting="unsafe").tobytes() not in recent
        del recent[:-4]
    assert len(reader._buffer) < 160
    return Count(injector.faults, accepted, wrong)


def fuzz_servos(frames: int, seed: int) -> Count:
    """Count status packets of servos that move."""
    bus, injector, rng = ServoBus(range(5)), FaultInjector(SHARE, seed), np.random.default_rng(seed)
    servos = [published.Servo(k, 170.0) for k in range(5)]
    accepted = wrong = 0
    for _ in range(frames // 5):
        block = CONTROL if rng.random() < 0.9 else IDENTITY
        bus.ask(block)
        sent, line = {}, b""
        for servo in servos:
            servo.table[100:147] = rng.bytes(47)
            servo.degrees = float(rng.uniform(90, 270))
            sent[servo.number] = servo.read(*block)
            line += injector.inject(published.packet(servo.number, b"\x55\x00" + sent[servo.number]))
        for status in bus.feed(line):
            accepted += 1
            wrong += status.error != 0 or status.parameters != sent[status.servo]
    return Count(injector.faults, accepted, wrong)


def _records(frames: int) -> Iterator[tuple[int, bytes]]:
    """Yield the number of each posture, and its record."""
    rows = [np.round(client.joints(drawn_angles(k)), 5).tolist() for k in range(POSTURES)]
    bodies = [json.dumps(row) for row in rows]
    for k in range(frames):
        text = f'{{"hand": "right", "time": {k}, "joints": {bodies[k % POSTURES]}}}'.encode()
        yield k, b"%08x %s\n" % (zlib.crc32(text), text)


def fuzz_openxr(frames: int, seed: int) -> Count:
    """Count records of a tracked hand."""
    injector, reader = FaultInjector(SHARE, seed), RecordReader("right")
    positions = [np.round(client.joints(drawn_angles(k)), 5)[:, :3] for k in range(POSTURES)]
    accepted = wrong = 0
    for k, line in _records(frames):
        record = reader.feed(float(k), injector.inject(line))
        if record is not None:
            accepted += 1
            # A line whose end was lost comes with the next one, and with it only that next is complete.
            sent = int(record.time)
            wrong += not (k - 1 <= sent <= k and np.array_equal(record.positions, positions[sent % POSTURES]))
    return Count(injector.faults, accepted, wrong)


def _documented_curls(angles: dict[str, float]) -> np.ndarray:
    """Curls of a hand as the documentation says: the sum of a finger's flexions as a share of a fist's."""
    curls = []
    for finger in client.FINGERS:
        kinds = ("MP", "IP") if finger == "thumb" else ("MP", "PIP", "DIP")
        full = FULL_FLEXION["thumb" if finger == "thumb" else "finger"]
        curls.append(sum(math.degrees(angles[f"{finger} {kind}"]) for kind in kinds) / full)
    return np.clip(curls, 0, 1)


def fuzz_opengloves(frames: int, seed: int) -> Count:
    """Count records that reach the limits of a glove behind OpenGloves' driver, as the host reads them."""
    pipe, records, injector = MemoryLine(115_200), MemoryLine(115_200), FaultInjector(SHARE, seed)
    model = lucidgloves()
    host = OpenGlovesHost(model, lambda: pipe, lambda: records, Guard(model))
    curls = [_documented_curls(drawn_angles(k)) for k in range(POSTURES)]
    spans = np.array(model.spans)
    taken = wrong = 0
    for k, line in _records(frames):
        records.to_host += injector.inject(line)
        host.poll(0.01 * k)
        if host.records.accepted > taken:
            read = host.reading.angles / spans
            # Rounded positions and orientations leave the curls to a thousandth.
            is_sent = [bool(np.abs(read - curls[(k - back) % POSTURES]).max() < 1e-3) for back in (0, 1)]
            wrong += not any(is_sent)
            taken = host.records.accepted
    return Count(injector.faults, taken, wrong)


def fuzz_lucidgloves(frames: int, seed: int, *, is_legacy: bool) -> Count:
    """Count lines of LucidGloves' firmware, which have no check; each line ends where it is told to."""
    injector, rng = FaultInjector(SHARE, seed), np.random.default_rng(seed)
    accepted = wrong = 0
    for _ in range(frames):
        numbers = rng.integers(0, 4096, 5).tolist()
        if is_legacy:
            line = "&".join(str(number) for number in [*numbers, 2047, 2047, 0, 0, 0, 0, 0, 0]).encode()
        else:
            line = "".join(f"{name}{number}" for name, number in zip("ABCDE", numbers)).encode()
        for part in injector.inject(line + b"\n").split(b"\n"):
            reading = read_line(part, 4095)
            if reading is not None:
                accepted += 1
                wrong += not np.array_equal(reading.curls, np.array(numbers) / 4095)
    return Count(injector.faults, accepted, wrong)


STREAMS = {
    "DOGlove, frames of the main board": fuzz_board,
    "DOGlove, status packets of the servos": fuzz_servos,
    "OpenXR, records": fuzz_openxr,
    "OpenGloves, records to curls": fuzz_opengloves,
    "LucidGloves, alpha encoding (no check)": lambda frames, seed: fuzz_lucidgloves(frames, seed, is_legacy=False),
    "LucidGloves, legacy encoding (no check)": lambda frames, seed: fuzz_lucidgloves(frames, seed, is_legacy=True),
}


def main() -> None:
    """Fuzz all streams, and print a row of a table for each."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames of each stream")
    parser.add_argument("--seed", type=int, default=1, help="seed of postures and faults")
    arguments = parser.parse_args()
    print("| stream | frames | spoilt | accepted | accepted wrong |\n|---|---|---|---|---|")
    for name, fuzz in STREAMS.items():
        faults, accepted, wrong = fuzz(arguments.frames, arguments.seed)
        print(f"| {name} | {arguments.frames:,} | {faults:,} | {accepted:,} | {wrong:,} |", flush=True)


if __name__ == "__main__":
    main()
