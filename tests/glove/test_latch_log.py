"""A line for each latch, whole whatever happens, with the frames that came before it."""

import json

import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.glove.guard import append_latch, read_latches
from tests.glove.virtual import World


def test_records_come_back_in_order(tmp_path):
    path = tmp_path / "latches.jsonl"
    for k in range(3):
        append_latch(path, {"at": float(k), "cause": f"cause {k}\n\N{DEGREE SIGN}"})
    records = read_latches(path)
    assert [(record["at"], record["cause"]) for record in records] == [
        (float(k), f"cause {k}\n\N{DEGREE SIGN}") for k in range(3)
    ]
    assert all(record["time"].endswith("+00:00") for record in records)


def test_a_line_that_was_cut_costs_no_other(tmp_path):
    path = tmp_path / "latches.jsonl"
    append_latch(path, {"cause": "first"})
    content = path.read_bytes()
    for end in range(1, len(content)):
        path.write_bytes(content + content[:end])
        append_latch(path, {"cause": "next"})
        # Cut right before its end it is whole.
        assert [record["cause"] for record in read_latches(path)] == ["first"] * (1 + (end == len(content) - 1)) + [
            "next"
        ]
        path.write_bytes(content + content[:end])
        assert read_latches(path)[0]["cause"] == "first"


@pytest.mark.parametrize("line", ["[]", "3", '{"time": 1}', '{"cause": "x"}', '{"cause": 1, "time": "x"}'])
def test_what_is_no_record_is_said(tmp_path, line):
    path = tmp_path / "other.jsonl"
    path.write_text('{"cause": "x", "time": "y"}\n' + line + "\n")
    with pytest.raises(ValueError, match="line 2 is .*: expected the record of a latch"):
        read_latches(path)


def test_a_host_knows_its_last_frames():
    """Both ways, in order, up to the latch; as JSON has them."""
    world = World().armed()
    world.simulation.obey({"fault": 1}, world.now)
    since = world.now
    while not world.host.guard.cause:
        world.run(0.001)
    frames = json.loads(json.dumps(world.host.last_frames()))
    times = [frame["at"] for frame in frames]
    assert len(frames) == 100 and times == sorted(times) and since - 0.4 < times[0] and times[-1] >= since
    latched = [frame for frame in frames if frame["way"] == "in" and frame["flags"] & 2]
    assert len(latched) == 1 and latched[0]["cause"] == 3 and latched[0] in frames[-2:]
    sent = [frame for frame in frames if frame["way"] == "out"]
    assert all(frame["kind"] == "COMMAND" and len(frame["values"]) == 14 for frame in sent) and len(sent) > 30


def test_a_log_that_cannot_be_written_is_said_first(folder, capsys):
    assert main(["glove", "run", "--port", "x", "--log", "no/folder/log"]) == 1
    assert "No such file" in (message := capsys.readouterr().err) and "no/folder/log" in message
    assert main(["glove", "run", "--log", "log"]) == 1
    assert "log needs the port of a glove" in capsys.readouterr().err
