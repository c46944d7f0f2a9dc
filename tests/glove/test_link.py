"""Two hosts: the latest wins, ages are told to within the way, and nothing too old is acted on."""

import contextlib
import random
import socket
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.network.link import MAX_CALLERS, MAX_INCOMPLETE, MAX_PIECES, PROOF_S, NetworkLink
from jaxgrasp.glove.network.messages import TAKEOVER_DELAY, Exchange, length_of
from jaxgrasp.glove.protocol.frames import stuff

SIZE = 5
KEY = bytes(range(32))


class Network:
    """Two sides with clocks of their own, and ways between them that take their time."""

    def __init__(self, offset: float, seed: int, loss: float = 0.0, slowest: float = 0.02):
        self.here, self.there = Exchange(1, SIZE), Exchange(2, SIZE)
        self.offset, self.loss, self.slowest = offset, loss, slowest
        self.rng = random.Random(seed)
        self.now = 50.0
        self.ways: list[tuple[float, Exchange, bytes]] = []

    def clock(self, side: Exchange) -> float:
        return self.now + (self.offset if side is self.there else 0.0)

    def step(self, values: np.ndarray) -> None:
        self.now += 0.005
        for sender, receiver in ((self.here, self.there), (self.there, self.here)):
            data = sender.outgoing(self.clock(sender), values)
            if self.rng.random() >= self.loss:
                self.ways.append((self.now + self.rng.uniform(0.0005, self.slowest), receiver, data))
        arrived = [message for message in self.ways if message[0] <= self.now]
        self.ways = [message for message in self.ways if message[0] > self.now]
        for _, receiver, data in arrived:
            receiver.incoming(self.clock(receiver), data)


@settings(max_examples=25, deadline=None)
@given(st.floats(-1e5, 1e5), st.integers(0, 999), st.floats(0, 0.5))
def test_ages_and_offsets_are_right_to_within_the_way(offset, seed, loss):
    network = Network(offset, seed, loss)
    assert network.here.age(network.now) == np.inf
    for k in range(200):
        network.step(np.full(SIZE, float(k)))
    for side, expected_offset in ((network.here, offset), (network.there, -offset)):
        assert abs(side.offset - expected_offset) <= side.round_trip / 2 + 1e-6
        true = network.clock(side) - (side.latest.sent - expected_offset)
        assert true - 1e-6 <= side.age(network.clock(side)) <= true + side.round_trip + 1e-6
        assert side.latest.values[0] >= 190 - 100 * loss
        assert side.accepted + side.stale + side.missing >= 199 - 40


def test_nothing_is_acted_on_before_the_clocks_are_known():
    network = Network(3.0, 0)
    data = network.here.outgoing(0.0, np.zeros(SIZE))
    assert network.there.incoming(3.0, data) is not None and network.there.age(3.0) == np.inf


def test_late_doubled_and_foreign_messages_are_not_acted_on():
    first, second, keyed = Exchange(1, SIZE), Exchange(2, SIZE), Exchange(3, SIZE, b"key")
    messages = [first.outgoing(float(k), np.full(SIZE, float(k))) for k in range(4)]
    taken = [second.incoming(9.0, messages[k]) is not None for k in (0, 2, 1, 2, 3)]
    assert taken == [True, True, False, False, True]
    assert (second.accepted, second.stale, second.missing, second.refused) == (3, 2, 1, 0)
    for spoilt in (messages[3][:-1], messages[3] + b"x", b"", bytes([messages[3][0] ^ 1]) + messages[3][1:]):
        assert second.incoming(9.0, spoilt) is None
    assert keyed.incoming(9.0, messages[3]) is None
    assert second.refused == 4 and keyed.refused == 1
    # Another program must wait until this one, which answers us, has been silent for a while; it has its own clock.
    first.incoming(8.9, second.outgoing(8.9, np.zeros(SIZE)))
    assert second.incoming(9.0, first.outgoing(9.0, np.zeros(SIZE))) is not None
    another = Exchange(7, SIZE)
    assert second.incoming(9.1, another.outgoing(-100.0, np.zeros(SIZE))) is None
    assert second.incoming(9.5, another.outgoing(-99.6, np.zeros(SIZE))) is not None
    assert second.age(9.5) == np.inf


def conversation(first: Exchange, second: Exchange, start: float, count: int = 50) -> tuple[list[bytes], list[bytes]]:
    """Let two sides exchange messages on one clock without delay; return the messages of each."""
    sent_messages: tuple[list[bytes], list[bytes]] = ([], [])
    for k in range(count):
        timestamp = start + 0.005 * k
        for sender, receiver, sent in ((first, second, sent_messages[0]), (second, first, sent_messages[1])):
            sent.append(sender.outgoing(timestamp, np.full(SIZE, float(k))))
            receiver.incoming(timestamp + 1e-4, sent[-1])
    return sent_messages


def acted_on(receiver: Exchange, messages: list[bytes], start: float, peer: Exchange | None = None) -> int:
    """Count the recorded messages that the receiver acts on when they are replayed at their original times."""
    count = 0
    for k, data in enumerate(messages):
        timestamp = start + 0.005 * k + 1e-4
        receiver.incoming(timestamp, data)
        count += receiver.age(timestamp) <= 0.03
        if peer is not None:
            peer.incoming(timestamp, receiver.outgoing(timestamp, np.zeros(SIZE)))
    return count


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("start", [0.0, 1000.0])
@pytest.mark.parametrize("key", [b"", KEY], ids=["open", "keyed"])
def test_a_recorded_session_is_not_acted_on_after_a_restart(side, start, key):
    """Byte for byte, at the same times of a clock that begins where it began before, as after a reboot."""
    ends = [Exchange(session, SIZE, key) for session in (11, 22)]
    recorded = conversation(*ends, start)
    assert all(end.age(start + 0.25) < 0.03 for end in ends)
    restarted = Exchange(33, SIZE, key)
    assert acted_on(restarted, recorded[side], start) == 0
    assert acted_on(restarted, recorded[side], start + 0.25) == 0, "nor a second time"
    assert acted_on(restarted, recorded[1 - side], start + 0.5) == 0, "nor what it said itself"


def test_replays_do_not_keep_the_true_other_side_away():
    """Old messages between those of a side that lives: it is understood all the same, and nothing old is acted on."""
    old = conversation(Exchange(11, SIZE, KEY), Exchange(22, SIZE, KEY), 0.0)[0]
    near, far = Exchange(33, SIZE, KEY), Exchange(44, SIZE, KEY)
    acted = 0
    for k, recorded in enumerate(old):
        timestamp = 0.005 * k
        near.incoming(timestamp, recorded)
        assert near.age(timestamp) > 0.03 or near.latest.session == 44
        far.incoming(timestamp, near.outgoing(timestamp, np.zeros(SIZE)))
        near.incoming(timestamp, far.outgoing(timestamp, np.ones(SIZE)))
        acted += near.age(timestamp) <= 0.03
        near.incoming(timestamp, recorded)
        assert near.latest.session == 44 or near.age(timestamp) == np.inf
    assert acted > 40


def test_what_is_not_of_the_key_is_refused():
    near, far, foreign = Exchange(1, SIZE, KEY), Exchange(2, SIZE, b"k" * 32), Exchange(3, SIZE)
    for end in (far, foreign):
        assert near.incoming(0.0, end.outgoing(0.0, np.zeros(SIZE))) is None
    assert near.incoming(0.0, near.outgoing(0.0, np.zeros(SIZE))) is None, "nor its own words, sent back"
    assert near.refused == 3


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_survived(data):
    assert Exchange(1, SIZE).incoming(0.0, data) is None


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_sockets(transport):
    server = NetworkLink("127.0.0.1", 0, SIZE, listens=True, transport=transport, oldest=0.5)
    client = NetworkLink("127.0.0.1", server.port, SIZE, transport=transport, oldest=0.5)

    def talk(until, seconds: float = 10.0) -> None:
        start = time.monotonic()
        while not until():
            assert time.monotonic() - start < seconds
            for link, value in ((server, 1.0), (client, 2.0)):
                link.send(time.monotonic(), np.full(SIZE, value))
            time.sleep(0.002)

    heard = lambda link: link.receive(time.monotonic())  # noqa: E731
    # Both must listen, or neither learns how long a way takes.
    have_both_heard = lambda: None not in [heard(link) for link in (server, client)]  # noqa: E731
    talk(have_both_heard)
    assert heard(server).values.tolist() == [2.0] * SIZE and heard(client).values.tolist() == [1.0] * SIZE
    assert abs(server.exchange.offset) <= server.exchange.round_trip
    client.close()
    time.sleep(0.6)
    assert heard(server) is None, "what it heard is too old"
    client = NetworkLink("127.0.0.1", server.port, SIZE, transport=transport, oldest=0.5)
    talk(have_both_heard)
    server.close()
    server = NetworkLink("127.0.0.1", client.port, SIZE, listens=True, transport=transport, oldest=0.5)
    talk(have_both_heard)
    server.close()
    client.close()


@pytest.mark.parametrize("is_peer", [False, True], ids=["stranger", "peer"])
@pytest.mark.parametrize(
    "piece, is_looked_at",
    [(b"\x01\0" * 30_000, False), ((stuff(bytes(range(1, 1 + length_of(SIZE)))) + b"\0") * 1000, True)],
    ids=["no message by its length", "no message by its check"],
)
def test_a_flood_does_not_keep_the_loop(piece, is_looked_at, is_peer):
    server = NetworkLink("127.0.0.1", 0, SIZE, listens=True, transport="tcp")
    flood = socket.create_connection(("127.0.0.1", server.port))
    if is_peer:
        flood.sendall(tcp_line(Exchange(1, SIZE)))
    until(lambda: server.receive(0.0) or server.exchange.accepted == is_peer)
    flood.setblocking(False)
    for _ in range(30):
        with contextlib.suppress(BlockingIOError):
            flood.send(piece)
        before = server.exchange.refused
        server.receive(0.0)
        assert server.exchange.refused - before <= (MAX_PIECES * MAX_INCOMPLETE / length_of(SIZE) if is_peer else 2)
    assert server.exchange.refused > 20 if is_looked_at else server.exchange.refused < 2
    flood.close()
    server.close()


def tcp_line(sender: Exchange, timestamp: float = 0.0) -> bytes:
    """Return the next message of a side as TCP carries it."""
    return stuff(sender.outgoing(timestamp, np.zeros(SIZE))) + b"\0"


def until(holds, seconds: float = 5.0) -> None:
    start = time.monotonic()
    while not holds():
        assert time.monotonic() - start < seconds
        time.sleep(0.001)


class Pair:
    """Two ends of a keyed link on a simulated clock."""

    def __init__(self, transport: str):
        self.transport, self.now = transport, 0.0
        self.server = self.end(0, listens=True)
        self.client = self.end(self.server.port)

    def end(self, port: int, **options) -> NetworkLink:
        return NetworkLink("127.0.0.1", port, SIZE, transport=self.transport, key=KEY, **options)

    def tick(self, count: int, between=lambda: None, sides=None) -> int:
        """Count the ticks in which both (or these) sides have a fresh message."""
        sides = (self.server, self.client) if sides is None else sides
        n_fresh = 0
        for _ in range(count):
            self.now += 0.005
            for side in sides:
                side.send(self.now, np.zeros(SIZE))
            between()
            time.sleep(0.001)
            n_fresh += None not in [side.receive(self.now) for side in sides]
        return n_fresh

    def stranger(self) -> socket.socket:
        if self.transport == "tcp":
            return socket.create_connection(("127.0.0.1", self.server.port))
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.connect(("127.0.0.1", self.server.port))
        return stranger

    def carried(self, message: bytes) -> bytes:
        return stuff(message) + b"\0" if self.transport == "tcp" else message


@pytest.fixture(params=["udp", "tcp"])
def linked(request):
    pair = Pair(request.param)
    until(lambda: pair.tick(1))
    yield pair
    pair.server.close()
    pair.client.close()


def recording() -> list[bytes]:
    """Return messages of an earlier session under the same key."""
    return conversation(Exchange(6, SIZE, KEY), Exchange(7, SIZE, KEY), 0.0)[0]


WORDS = {
    "none": list,
    "short": lambda: [b"\x01\0"],
    "long": lambda: [b"x" * 5000],
    "other key": lambda: [Exchange(5, SIZE, b"k" * 32).outgoing(0.0, np.zeros(SIZE))],
    "no key": lambda: [Exchange(5, SIZE).outgoing(0.0, np.zeros(SIZE))],
    "recorded": lambda: recording()[:3],
}


@pytest.mark.parametrize("words", WORDS)
def test_no_stranger_takes_the_place_of_a_peer_that_is_there(linked, words):
    messages = [linked.carried(message) for message in WORDS[words]()]
    strangers: list[socket.socket] = []

    def call() -> None:
        strangers.append(linked.stranger())
        if len(strangers) > 40:
            strangers.pop(0).close()
        for message in messages:
            strangers[-1].send(message)

    assert linked.tick(100, call) >= 95
    for stranger in strangers:
        stranger.setblocking(False)
        with contextlib.suppress(OSError):
            assert stranger.recv(1000) == b"", "a message for the peer went to a stranger"
        stranger.close()


def test_a_recording_does_not_keep_the_place_of_a_peer_that_was_silent(linked):
    """Neither where a side listens, nor where it calls: that one is led to no other address."""
    server, stranger, recorded = linked.server, linked.stranger(), recording()
    targets = [stranger.getpeername()]
    if linked.transport == "udp":
        # A socket of its own: the true side's address is free for nobody else.
        stranger.close()
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        targets.append(("127.0.0.1", linked.client._carrier._socket.getsockname()[1]))

    def play() -> None:
        if recorded:
            message = linked.carried(recorded.pop(0))
            for target in targets:
                stranger.send(message) if linked.transport == "tcp" else stranger.sendto(message, target)

    linked.now += 2 * TAKEOVER_DELAY
    n_accepted = server.exchange.accepted
    play()
    time.sleep(0.01)
    for side in (server, linked.client):
        side.receive(linked.now)
    assert server.exchange.accepted > n_accepted, "the recording was not even taken for a new side"
    linked.tick(20)
    assert linked.tick(20, play) >= 18
    stranger.close()


@pytest.mark.parametrize("linked", ["tcp"], indirect=True)
def test_callers_without_a_message_are_bounded_in_number_and_age(linked):
    strangers = [linked.stranger() for _ in range(3 * MAX_CALLERS)]
    linked.tick(10)
    is_closed = [has_ended(stranger) for stranger in strangers]
    assert is_closed == [True] * 2 * MAX_CALLERS + [False] * MAX_CALLERS
    assert linked.tick(int(PROOF_S / 0.005) + 10) >= 195
    assert all(has_ended(stranger) for stranger in strangers)
    for stranger in strangers:
        stranger.close()


def has_ended(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(100) == b""
    except BlockingIOError:
        return False


def test_a_peer_that_starts_anew_takes_its_own_place(linked):
    linked.client.close()
    again = linked.end(linked.server.port)
    linked.tick(int(TAKEOVER_DELAY / 0.005) + 10, sides=(linked.server, again))
    assert linked.tick(20, sides=(linked.server, again)) >= 18
    again.close()


def test_answers_go_only_to_who_is_understood():
    server = NetworkLink("127.0.0.1", 0, SIZE, listens=True, oldest=0.5)
    client = NetworkLink("127.0.0.1", server.port, SIZE, oldest=0.5)
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for k in range(20):
        client.send(0.001 * k, np.ones(SIZE))
        stranger.sendto(b"x", ("127.0.0.1", server.port))
        time.sleep(0.002)
        server.receive(0.001 * k)
        server.send(0.001 * k, np.zeros(SIZE))
    time.sleep(0.01)
    client.receive(0.02)
    assert client.exchange.accepted > 10
    for end in (server, client, stranger):
        end.close()


@pytest.mark.parametrize(
    "change, message",
    [
        ({"transport": "pigeon"}, "expected 'udp' or 'tcp'"),
        ({"size_in": 4000}, "size_in is 4000"),
        ({"port": 99_999}, "port is 99999: expected 0 to 65535"),
        ({"key": b"x" * 65}, "key has 65 bytes: expected at most 64"),
        ({"oldest": 0.0}, "oldest is 0.0: expected a positive time"),
    ],
)
def test_bad_settings(unchecked, change, message):
    with pytest.raises(ValueError, match=message):
        NetworkLink(**{"host": "127.0.0.1", "port": 0, "size_in": SIZE, "listens": True, **change})
