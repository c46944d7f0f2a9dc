"""The server: whom it serves, and what it does not take."""

import contextlib
import socket
import threading
import time

import pytest

from jaxgrasp.view.viewer_server import check_free, serving

viser = pytest.importorskip("viser", reason="the live scene needs viser")


def asked(port: int, raw: bytes) -> bytes:
    """What a server answers to some bytes."""
    with socket.create_connection(("127.0.0.1", port), timeout=0.5) as line:
        line.sendall(raw)
        with contextlib.suppress(OSError):
            return line.recv(200)
    return b""


def page_is_served(port: int) -> bool:
    return asked(port, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n").startswith(b"HTTP/1.1 200")


def test_a_port_in_use_is_said_with_one_that_is_free():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=rf"port {port} of 127.0.0.1 is in use; (\d+) is free: --port \1") as said:
            check_free("127.0.0.1", port)
        check_free("127.0.0.1", int(str(said.value).split()[-1]))
        with pytest.raises(OSError, match=r"(\d+) is free: --view-port \1"):
            check_free("127.0.0.1", port, "--view-port")


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none(port):
    with pytest.raises(ValueError, match=f"port is {port}: expected 0 to 65535"):
        check_free("127.0.0.1", port)


def test_an_address_that_this_machine_has_not():
    with pytest.raises(OSError, match=r"cannot listen at 192\.0\.2\.1:9999"):
        check_free("192.0.2.1", 9999)


@pytest.fixture(scope="module")
def served():
    with serving(port=0) as server:
        yield server
    # Whatever is left would be another test's.
    assert not [one for one in threading.enumerate() if one is server._websock_server._server_thread]


def test_it_listens_on_this_machine_alone_and_says_nothing(capsys):
    with serving(port=0) as server:
        assert server.get_host() == "127.0.0.1"
        assert page_is_served(server.get_port())
    time.sleep(0.1)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    "raw",
    [b"\x00\xff" * 400, b"GET /../../etc/passwd HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\n" * 3, b"\x16\x03\x01", b""],
)
def test_garbage_on_its_port_is_survived(served, raw, capfd):
    answer = asked(served.get_port(), raw) if raw else b""
    assert b"root:" not in answer
    assert page_is_served(served.get_port())
    assert capfd.readouterr().err == ""


def test_uploads_and_shared_addresses_are_refused(served):
    from viser import _messages
    from websockets.sync.client import connect

    port, protocol = served.get_port(), f"viser-v{viser.__version__}"
    # viser itself takes what is addressed to any of its controls, and keeps it.
    control = served.gui.add_slider("a slider", 0.0, 1.0, 0.1, 0.5)._impl.uuid
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol]) as line:
        line.recv(timeout=5)
        start = _messages.FileTransferStartUpload(control, "1", "name", "text/plain", 2, 6)
        part = _messages.FileTransferPart(control, "1", 0, b"abc")
        for message in (start, part, _messages.ShareUrlRequest()):
            line.send(packed(message))
        time.sleep(0.3)
        assert served.gui._current_file_upload_states == {}
        line.send(b"no message at all")
        with contextlib.suppress(Exception):
            while True:
                line.recv(timeout=1)
    assert served._share_tunnel is None
    assert page_is_served(port)


def packed(message) -> bytes:
    """A message as a browser sends it."""
    import msgspec

    return msgspec.msgpack.encode(message.as_serializable_dict())


def test_a_browser_that_leaves_and_a_second_one(served):
    from websockets.sync.client import connect

    address, protocol = f"ws://127.0.0.1:{served.get_port()}", f"viser-v{viser.__version__}"
    box = served.scene.add_box("/box")
    for _ in range(3):
        with connect(address, subprotocols=[protocol], close_timeout=0.01) as line:
            line.recv(timeout=5)
            # Gone without a word, in the middle of what is sent.
            line.socket.shutdown(socket.SHUT_RDWR)
        for k in range(50):
            box.position = (0.0, 0.0, 0.01 * k)
    with contextlib.ExitStack() as stack:
        lines = [stack.enter_context(connect(address, subprotocols=[protocol])) for _ in range(2)]
        for line in lines:
            assert line.recv(timeout=5)
    assert page_is_served(served.get_port())
