"""Files from anywhere are refused by one line that names the place, or used; nothing else comes of them."""

import copy
import json
import random
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.files.printable import LONGEST_MESSAGE
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.other_devices.alignment import Alignment, save_alignment
from jaxgrasp.glove.sensors import nominal_sensors, save_sensors
from jaxgrasp.grip.scene_file import ready_scenes

MISSING = object()
VALUES = (
    *(MISSING, -1, 0, True, 1e-320, 1e308, float("inf"), float("nan"), 10**25, 10**400),
    *("", "\x1b[31m\x00\n", "A" * 100_000, [], [[]], ["a"], [[1, 2], [3]], [1e308] * 20, {}, {"a": 1}),
)
DAMAGED = (
    *(
        b"",
        b"\x00",
        b"\xff\xfe\x00",
        b"[",
        b"{" * 10_000,
        b"[" * 10_000,
        b"null",
        b"1e999",
        b"\n" * 10_000,
        b"PK\x03\x04",
    ),
    *(b'"' + b"a" * 200_000 + b'"', b"\x1b[2J = 1\n", b"a=1\na=2", b'{"a":' * 5000 + b"1" + b"}" * 5000),
)
PLAN = """
name = "weights"
seed = 3
[stimulus]
kind = "weight"
fingers = ["index", "middle"]
joint = "index MP"
[session]
references = [1.0, 2.0]
practice = 1
feedback = true
[procedure]
levels = [0.1, 0.2]
series = 2
repeats = 2
"""
MODEL = """
name = "two joints"
joints = ["index MP", "index PIP"]
limits = [0.1, 0.2]
rate = 200.0
quantum = 0.001
"""


def paths(content: Any, above: tuple = ()) -> Iterator[tuple]:
    """Yield the path of every value in a table of tables; of a list, only those of its first two items."""
    entries = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in list(entries)[: 2 if isinstance(content, list) else None]:
        yield (*above, key)
        yield from paths(value, (*above, key))


def replaced(content: Any, path: tuple, value: Any) -> Any:
    content = copy.deepcopy(content)
    last = content
    for key in path[:-1]:
        last = last[key]
    if value is MISSING:
        del last[path[-1]]
    else:
        last[path[-1]] = value
    return content


def as_toml(value: Any) -> str:
    """Write a value as TOML, with its tables inline."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {as_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def toml_file(table: dict) -> bytes:
    return "".join(f"{json.dumps(key)} = {as_toml(value)}\n" for key, value in table.items()).encode()


def json_file(content: Any) -> bytes:
    return json.dumps(content).encode()


def damaged(good: bytes) -> Iterator[bytes]:
    """Yield a file with bytes changed, cut off or doubled, and contents that are no such file at all."""
    draws = random.Random(0)
    for changes in (1, 1, 1, 3, 3, 10, 10):
        changed = bytearray(good)
        for _ in range(changes):
            changed[draws.randrange(len(changed))] = draws.randrange(256)
        yield bytes(changed)
    yield from (good[: len(good) // 2], good[:-1], good + good, *DAMAGED)


def files(good: bytes, parse: Callable[[bytes], Any], write: Callable[[Any], bytes]) -> Iterator[bytes]:
    content = parse(good)
    for path in paths(content):
        for value in VALUES:
            yield write(replaced(content, path, value))
    yield from damaged(good)


@pytest.fixture
def refused_or_used(folder, capsys):
    """Return a function that runs a command on each of many files of one name and counts the refused ones."""

    def attack(name: str, contents: Iterator[bytes], *command: str) -> int:
        refused = 0
        for content in contents:
            Path(name).write_bytes(content)
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                status = main([*command])
            captured = capsys.readouterr()
            lines = [line for line in captured.err.splitlines() if not line.startswith("compiling")]
            assert status in (0, 1) and len(lines) == status, (content[:500], lines)
            assert all(c.isprintable() or c == "\n" for c in captured.out + captured.err), content[:500]
            assert all(len(line) < LONGEST_MESSAGE + 100 for line in lines), content[:500]
            refused += status
        return refused

    return attack


@pytest.mark.repeats
@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 10))])
def test_plans(refused_or_used, part):
    many = list(files(PLAN.encode(), lambda good: tomllib.loads(good.decode()), toml_file))
    # Neighbours are alike: each part gets some of every kind.
    random.Random(0).shuffle(many)
    many = many[part::10]
    assert len(many) > refused_or_used("plan.toml", iter(many), "experiment", "plan", "plan.toml") > len(many) / 2


def test_scenes(refused_or_used):
    good = ready_scenes()["cylinder"].read_bytes()
    many = list(files(good, lambda good: tomllib.loads(good.decode()), toml_file))
    assert len(many) > refused_or_used("scene.toml", iter(many), "scene", "check", "scene.toml") > len(many) / 2


def test_models_of_gloves(refused_or_used):
    many = files(MODEL.encode(), lambda good: tomllib.loads(good.decode()), toml_file)
    Path("pairs.csv").write_text("x\n")
    command = ("glove", "calibrate", "pairs.csv", "--no-plot", "--model", "glove.toml")
    assert refused_or_used("glove.toml", many, *command) > 50


@pytest.mark.repeats
@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 4))])
@pytest.mark.parametrize("which", ["calibration", "alignment"])
def test_calibrations_and_alignments(refused_or_used, which, part):
    name = f"{which}.json"
    if which == "calibration":
        save_sensors(nominal_sensors(lrp_hand_master()), Path(name))
    else:
        save_alignment(Alignment(np.eye(3), np.eye(3), np.zeros(3)), Path(name))
    many = list(files(Path(name).read_bytes(), json.loads, json_file))[part::4]
    assert refused_or_used(name, iter(many), "glove", "run", f"--{which}", name, "--port", "nowhere") > len(many) / 2


def test_recorded_pairs(refused_or_used):
    joints = lrp_hand_master().joints
    rows = [
        "sensor,channel,counts,value",
        *(f"encoder,{joint},{100 * k},{0.1 * k}" for joint in joints for k in range(4)),
    ]

    def many() -> Iterator[bytes]:
        for place, cell in enumerate(rows[1].split(",")):
            for text in (
                "",
                "nan",
                "-inf",
                "1e400",
                "1e308",
                "9" * 400,
                "1_0",
                "\u0661",
                "'",
                '"a\nb"',
                "A" * 200_000,
                cell + "," + cell,
            ):
                cells = rows[1].split(",")
                cells[place] = text
                yield "\n".join([rows[0], ",".join(cells), *rows[2:]]).encode()
        yield from damaged("\n".join(rows).encode())

    command = ("glove", "calibrate", "pairs.csv", "--no-plot", "--out", "calibration.json")
    assert refused_or_used("pairs.csv", many(), *command) > 50


@pytest.mark.slow
def test_records(refused_or_used, folder):
    Path("plan.toml").write_text(
        "[session]\nreferences = [1.0]\npractice = 1\n[procedure]\nseries = 1\nlevels = [0.1, 0.2]"
    )
    assert main(["experiment", "run", "plan.toml", "--subject", "S1", "--simulate", "--out", "records"]) == 0
    records = [json.loads(line) for line in Path("records/S1.jsonl").read_text().splitlines()]

    def lines(content: list) -> bytes:
        return "".join(json.dumps(record) + "\n" for record in content).encode()

    def many() -> Iterator[bytes]:
        for place in (0, 2):
            for path in paths(records[place]):
                for value in VALUES[:: 1 if place else 2]:
                    yield lines([*records[:place], replaced(records[place], path, value), *records[place + 1 :]])
        for place in range(len(records)):
            yield lines(records[:place] + records[place + 1 :])
            yield lines(records[: place + 1] + records[place:])
        yield from damaged(lines(records))

    command = ("experiment", "analyse", "records", "--no-report", "--method", "line")
    assert refused_or_used("records/S1.jsonl", many(), *command) > 200
