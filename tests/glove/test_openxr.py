"""OpenXR hand tracking: records become angles and wrist poses, or are refused; nothing is ever armed."""

import json
import os
import socket
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.line import LineError, PipeLine, UdpLine, open_port
from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.loop.rendering import IOController
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.other_devices.alignment import rotation_of
from jaxgrasp.glove.other_devices.openxr import OpenXRHost, RecordReader, WristTracker, openxr, read_hand_record
from jaxgrasp.glove.simulated.simulation import HeldPeer, MemoryLine
from tests.glove import simulated_openxr as client
from tests.glove.fuzz import drawn_angles, fuzz_openxr

MODEL = openxr()


def host(hand: str = "right") -> tuple[OpenXRHost, MemoryLine]:
    line = MemoryLine(115_200)
    return OpenXRHost(MODEL, lambda: line, Guard(MODEL), hand=hand), line


@pytest.mark.parametrize("hand", ["right", "left"])
@pytest.mark.parametrize("seed", range(4))
def test_a_tracked_hand_bends_the_virtual_hand(hand, seed):
    angles, rng = drawn_angles(seed), np.random.default_rng(seed)
    wrist = client.turn(0, rng.uniform(-1, 1)) @ client.turn(1, rng.uniform(-3, 3)) @ client.turn(2, rng.uniform(-1, 1))
    device, line = host(hand)
    line.to_host += client.line(1.0, client.joints(angles, hand, wrist), hand)
    reading = device.poll(5.0)
    assert device.state == LinkState.LINKED and reading.angles_at == 5.0
    np.testing.assert_allclose(reading.angles, [angles[joint] for joint in MODEL.joints], atol=1e-6)
    # Imported here, so that all other laws of this file need no JAX.
    from jaxgrasp.hand import human_hand

    assert set(MODEL.joints) == set(human_hand().joints) and not any(MODEL.limits)


def test_forces_are_asked_for_and_none_is_given():
    device, line = host()
    controller = IOController(device, HeldPeer())
    torques = np.full(19, 0.1)
    for k in range(10):
        timestamp = 0.01 * k
        line.to_host += client.line(timestamp, client.joints(drawn_angles(0)))
        controller.peer.latest_law = TorqueLaw(timestamp, True, np.zeros(19), torques, np.zeros((19, 19)))
        controller.step(timestamp)
    with pytest.raises(ValueError, match="there is nothing to arm: hand tracking resists nothing: forces are shown"):
        controller.arm(0.1)
    state = controller.peer.state
    np.testing.assert_array_equal(state.asked, torques)
    assert not state.torques.any() and not state.cut_s.any() and bytes(line.to_device) == b""


def test_what_is_no_record():
    rows = client.joints(drawn_angles(0))
    good = client.line(1.0, rows)[:-1]
    assert read_hand_record(good) is not None

    def summed(content) -> bytes:
        text = content if isinstance(content, bytes) else json.dumps(content).encode()
        return b"%08x " % zlib.crc32(text) + text

    record = {"hand": "right", "time": 1.0, "joints": rows}
    long_bone = [row[:] for row in rows]
    long_bone[10][0] += 1.0
    long_quaternion = [row[:] for row in rows]
    long_quaternion[7][3:] = [1.0, 1.0, 0.0, 0.0]
    for bad in (
        good[1:],
        good[:-1],
        b"",
        b"00000000 {}",
        b" " * 20,
        summed(b"{"),
        summed(b"[" * 9_000),
        summed(5),
        summed([]),
        summed(record | {"hand": "both"}),
        summed(record | {"hand": ["right"]}),
        summed(record | {"time": "now"}),
        summed(record | {"time": True}),
        summed(record | {"joints": rows[:-1]}),
        summed(record | {"joints": [row[:6] for row in rows]}),
        summed(record | {"joints": "x"}),
        summed(record | {"joints": [[None] * 7] * 26}),
        summed(record | {"joints": [[10**400] * 7] * 26}),
        summed(json.dumps(record).replace("0.", "NaN", 1).encode()),
        summed(record | {"joints": long_bone}),
        summed(record | {"joints": long_quaternion}),
        summed({"hand": "right", "time": 1.0}),
    ):
        assert read_hand_record(bad) is None, bad[:60]


def test_records_are_taken_in_order_and_of_one_hand():
    reader, rows = RecordReader("right"), client.joints(drawn_angles(1))
    assert reader.feed(0.0, client.line(5.0, rows)).time == 5.0
    assert reader.feed(0.01, client.line(4.99, rows)) is None and reader.stale == 1
    assert reader.feed(0.01, client.line(5.0, rows)) is None and reader.stale == 2
    assert reader.feed(0.02, client.line(6.0, rows, "left")) is None and reader.others == 1
    assert reader.feed(0.03, client.line(5.1, rows) + client.line(5.2, rows)).time == 5.2
    assert reader.feed(1.0, client.line(0.0, rows)).time == 0.0, "after a silence a sender may begin anew"
    with pytest.raises(ValueError, match="hand is 'both': expected 'right' or 'left'"):
        RecordReader("both")


def test_a_hand_that_is_lost_is_said_to_be():
    device, line = host()
    assert device.poll(0.0) is device.reading and device.trouble == "no record of the hand has come"
    line.to_host += client.line(1.0, client.joints({}), "left")
    line.to_host += client.line(1.0, client.joints({}, "left"), "left")
    device.poll(0.1)
    assert device.trouble == "records of the other hand came, and none of the right one"
    line.to_host += client.line(1.0, client.joints({}))
    device.poll(0.2)
    device.poll(0.5)
    assert device.state == LinkState.GREETING and device.trouble == "the hand is not tracked"
    line.is_plugged = False
    device.poll(0.6)
    assert device.state == LinkState.CLOSED and device.report() == {
        "links": 1,
        "accepted": 1,
        "refused": 0,
        "stale": 0,
        "others": 2,
    }
    with pytest.raises(ValueError, match="the limit of thumb MP is 0.12: expected 0, since hand tracking resists"):
        OpenXRHost(lrp_hand_master(), lambda: line, Guard(lrp_hand_master()))


def test_the_wrists_pose_is_in_our_axes():
    line = MemoryLine(115_200)
    tracker = WristTracker(line)
    assert tracker.poll(0.0) is None
    # A palm-down hand that points forward, 1.2 m up, 0.3 m ahead, 0.1 m to the right; rolled by 0.3 rad.
    line.to_host += client.line(1.0, client.joints({}, wrist=client.turn(2, 0.3), place=(0.1, 1.2, -0.3)))
    sample = tracker.poll(0.0)
    np.testing.assert_allclose(sample.position, [0.3, -0.1, 1.2], atol=1e-9)
    # About z back is about minus x forward.
    np.testing.assert_allclose(rotation_of(sample.quaternion), client.turn(0, -0.3), atol=1e-6)
    line.to_host += client.line(1.01, client.joints({}, place=(3.0, 1.2, -0.3)))
    assert tracker.poll(0.01) is sample and tracker.jumps.refused == 1, "no hand jumps by three metres"


def test_records_come_by_udp():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    line = open_port(f"udp:127.0.0.1:{port}", 115_200)
    assert isinstance(line, UdpLine)
    device = OpenXRHost(MODEL, lambda: line, Guard(MODEL))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        record = client.line(1.0, client.joints({"index PIP": 1.0}))
        # A datagram that is cut spoils no other.
        for data in (record[:700], record):
            sender.sendto(data, ("127.0.0.1", port))
    for k in range(100):
        if device.poll(0.01 * k).angles_at > -1 and device.state == LinkState.LINKED:
            break
    assert device.state == LinkState.LINKED and device.records.refused == 1
    with pytest.raises(LineError, match=f"port udp:127.0.0.1:{port} cannot be opened"):
        UdpLine("127.0.0.1", port)
    device.close(1.0)
    for bad in ("udp:", "udp:host", "udp:host:0", "udp:host:x"):
        with pytest.raises(ValueError, match="expected udp:HOST:PORT"):
            open_port(bad, 9600)


@pytest.mark.skipif(os.name != "posix", reason="named pipes of a file system")
def test_records_come_by_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "records")
    line = open_port(str(tmp_path / "records"), 9600)
    assert isinstance(line, PipeLine) and line.read() == b""
    device = OpenXRHost(MODEL, lambda: line, Guard(MODEL))
    with open(tmp_path / "records", "wb") as sender:
        sender.write(client.line(1.0, client.joints({})))
        sender.flush()
        device.poll(0.0)
    assert device.state == LinkState.LINKED
    device.close(0.0)
    with pytest.raises(LineError, match="is closed"):
        line.read()


def test_spoilt_records_are_refused():
    faults, accepted, wrong = fuzz_openxr(4_000, 0)
    assert faults > 700 and accepted > 3_000 and wrong == 0


@pytest.mark.slow
def test_of_a_million_records_none_is_accepted_wrong():
    faults, accepted, wrong = fuzz_openxr(1_000_000, 1)
    assert faults > 190_000 and accepted > 750_000 and wrong == 0


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=300), max_size=5))
def test_any_bytes_are_survived(parts):
    device, line = host()
    for part in parts:
        line.to_host += part
        device.poll(1.0)
    line.to_host += b"\n" + client.line(1.0, client.joints({}))
    assert np.all(np.isfinite(device.poll(1.0).angles)) and device.state == LinkState.LINKED
