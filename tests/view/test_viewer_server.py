"""The server: whom it serves, and what it does not take."""

import contextlib
import socket
import threading
import time

import pytest

from jaxgrasp.view.viewer_server import RequestGuard, check_free, guarding, is_loopback, page_address, serving

viser = pytest.importorskip("viser", reason="the live scene needs viser")


def request(port: int, raw: bytes, most: int = 200) -> bytes:
    """Send raw bytes to the server and return its answer."""
    with socket.create_connection(("127.0.0.1", port), timeout=0.5) as line:
        line.sendall(raw)
        with contextlib.suppress(OSError):
            return line.recv(most)
    return b""


def page_is_served(port: int) -> bool:
    return request(port, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n").startswith(b"HTTP/1.1 200")


def test_a_port_in_use_is_said_with_one_that_is_free():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        with pytest.raises(OSError, match=rf"port {port} of 127.0.0.1 is in use; (\d+) is free: --port \1") as raised:
            check_free("127.0.0.1", port)
        check_free("127.0.0.1", int(str(raised.value).split()[-1]))
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
    assert not [thread for thread in threading.enumerate() if thread is server._websock_server._server_thread]


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
    answer = request(served.get_port(), raw) if raw else b""
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


SITES = {
    # Host and Origin of a request; the port of the server stands for {}.
    "no page": ("127.0.0.1:{}", None, True),
    "its page by address": ("127.0.0.1:{}", "http://127.0.0.1:{}", True),
    "its page by name": ("localhost:{}", "http://localhost:{}", True),
    "its page, name in capitals": ("LOCALHOST:{}", "http://localhost:{}", True),
    "its page by IPv6": ("[::1]:{}", "http://[::1]:{}", True),
    "its page through a tunnel": ("localhost:9000", "http://localhost:9000", True),
    "its page behind a proxy": ("scene.example", "https://scene.example", True),
    "its page at port 80": ("localhost:80", "http://localhost", True),
    "another site": ("127.0.0.1:{}", "http://evil.example", False),
    "another site at its port": ("127.0.0.1:{}", "http://evil.example:{}", False),
    "another site, begins alike": ("127.0.0.1:{}", "http://127.0.0.1:{}.evil.example", False),
    "another site, ends alike": ("scene.example", "http://evil-scene.example", False),
    "another site below": ("localhost:{}", "http://localhost.evil.example:{}", False),
    "another server of this machine": ("127.0.0.1:{}", "http://127.0.0.1:8888", False),
    "another name of this machine": ("127.0.0.1:{}", "http://localhost:{}", False),
    "a page of a file": ("127.0.0.1:{}", "null", False),
    "a page of an extension": ("127.0.0.1:{}", "chrome-extension://127.0.0.1:{}", False),
    "an empty origin": ("127.0.0.1:{}", "", False),
    "DNS rebinding": ("evil.example:{}", "http://evil.example:{}", False),
    "DNS rebinding, a page": ("evil.example:{}", None, False),
    "DNS rebinding, a name like an address": ("127.0.0.1.evil.example:{}", None, False),
    "an address of another machine": ("192.0.2.1:{}", None, False),
    "a host before the true one": ("evil.example@127.0.0.1:{}", None, False),
    "a host after the true one": ("127.0.0.1:{}@evil.example", None, False),
    "no host": (None, None, False),
    "an empty host": ("", None, False),
    "two hosts": ("127.0.0.1:{}\r\nHost: evil.example", None, False),
    "two origins": ("127.0.0.1:{}", "http://127.0.0.1:{}\r\nOrigin: http://evil.example", False),
}


@pytest.fixture(scope="module")
def named():
    with serving(port=0, allowed_hosts=["scene.example"]) as server:
        yield server


@pytest.mark.parametrize("upgrade", [False, True], ids=["page", "socket"])
@pytest.mark.parametrize("site", SITES)
def test_only_its_own_pages_are_answered(named, site, upgrade):
    """Sockets carry scene and sliders; the page itself is refused likewise, so that no name leads to both."""
    host, origin, is_own = SITES[site]
    port = named.get_port()
    lines = ["GET / HTTP/1.1"]
    lines += [] if host is None else [f"Host: {host.format(port)}"]
    lines += [] if origin is None else [f"Origin: {origin.replace('{}', str(port))}"]
    if upgrade:
        lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]
    answer = request(port, "\r\n".join([*lines, "", ""]).encode())
    expected = (b"101" if upgrade else b"200") if is_own else b"403"
    assert answer.split(b" ")[1] == expected, answer


def test_sliders_move_for_its_own_page_alone(named):
    from viser import _messages
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    port, protocol = named.get_port(), f"viser-v{viser.__version__}"
    slider = named.gui.add_slider("a slider", 0.0, 1.0, 0.1, 0.5)
    move = packed(_messages.GuiUpdateMessage(slider._impl.uuid, {"value": 0.9}))
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], origin="http://evil.example")
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], origin=f"http://127.0.0.1:{port}") as line:
        line.recv(timeout=5)
        line.send(move)
        deadline = time.monotonic() + 5
        while slider.value != 0.9 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert slider.value == 0.9


def test_no_other_site_shows_it_in_a_frame(named):
    answer = request(named.get_port(), b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", 1000)
    assert b"Content-Security-Policy: frame-ancestors 'self'\r\n" in answer


def test_where_others_may_call_addresses_and_the_machines_name_are_taken():
    for listens_on in ("0.0.0.0", "::", "192.0.2.7", "a-machine"):
        guard = RequestGuard(listens_on)
        for host in ("192.0.2.7:80", "[2001:db8::7]:80", f"{socket.gethostname()}:80", "localhost", "127.0.0.1"):
            assert guard.refusal(host, f"http://{host}") is None
            assert guard.refusal(host, "http://evil.example") is not None
        assert "evil.example" in guard.refusal("evil.example", None)
    assert RequestGuard("a-machine").refusal("A-Machine:8080", None) is None


@pytest.mark.parametrize("name", ["", "http://a.example", "a.example:80", "a.example/x", "a@b"])
def test_an_allowed_host_that_is_none(name):
    with pytest.raises(ValueError, match=r"allowed_hosts\[1\] is .*: expected a name or address without a port"):
        RequestGuard("127.0.0.1", ["a.example", name])


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch):
    from jaxgrasp.view import viewer_server

    @contextlib.contextmanager
    def unguarded(*_):
        yield threading.Event()

    monkeypatch.setattr(viewer_server, "guarding", unguarded)
    with pytest.raises(RuntimeError, match="starts its server in another way"), serving(port=0):
        pass


def test_servers_of_other_threads_are_left_alone():
    import websockets.asyncio.server as module

    calls = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "serve", lambda *_, process_request: calls.append(process_request))
        before = module.serve
        with guarding(RequestGuard("127.0.0.1"), lambda: False) as is_guarded:
            module.serve(process_request=print)
        assert module.serve is before
    assert calls == [print] and not is_guarded.is_set()


def packed(message) -> bytes:
    """Encode a message as a browser sends it."""
    import msgspec

    return msgspec.msgpack.encode(message.as_serializable_dict())


TOKEN = "a-token_of.its-own"


@pytest.fixture(scope="module")
def with_token():
    with serving(port=0, token=TOKEN) as server:
        yield server.get_port()


@pytest.mark.parametrize(
    ("path", "cookie", "is_served"),
    [
        ("/", None, False),
        (f"/?token={TOKEN}", None, True),
        (f"/?token={TOKEN[:-1]}", None, False),
        ("/?token=", None, False),
        (f"/?token={TOKEN.upper()}", None, False),
        (f"/?tokens={TOKEN}", None, False),
        ("/", f"jaxgrasp_token={TOKEN}", True),
        ("/", f"other=1; jaxgrasp_token={TOKEN}; more=2", True),
        ("/", f"other_jaxgrasp_token={TOKEN}", False),
        ("/", "jaxgrasp_token=\xe9", False),
    ],
)
def test_a_page_with_a_token_is_served_to_who_has_it(with_token, path, cookie, is_served):
    headers = "Host: 127.0.0.1\r\n" + (f"Cookie: {cookie}\r\n" if cookie else "")
    answer = request(with_token, f"GET {path} HTTP/1.1\r\n{headers}\r\n".encode("latin-1"), 1000)
    assert answer.startswith(b"HTTP/1.1 200" if is_served else b"HTTP/1.1 403")
    assert (f"Set-Cookie: jaxgrasp_token={TOKEN}; Path=/; HttpOnly; SameSite=Strict".encode() in answer) == is_served


def test_the_socket_of_a_page_with_a_token_needs_it_too(with_token):
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    address, protocol = f"ws://127.0.0.1:{with_token}", f"viser-v{viser.__version__}"
    with pytest.raises(InvalidStatus):
        connect(address, subprotocols=[protocol])
    cookie = {"Cookie": f"jaxgrasp_token={TOKEN}"}
    with connect(address, subprotocols=[protocol], additional_headers=cookie) as line:
        assert line.recv(timeout=5)


def test_addresses_for_a_browser():
    assert page_address("127.0.0.1", 8080) == "http://127.0.0.1:8080"
    assert page_address("10.0.0.7", 8080, "t") == "http://10.0.0.7:8080/?token=t"
    assert page_address("::1", 8080) == "http://[::1]:8080"
    assert page_address("0.0.0.0", 1, "t") == f"http://{socket.gethostname()}:1/?token=t"
    loopback = {"127.0.0.1": True, "::1": True, "localhost": True, "0.0.0.0": False, "::": False, "10.0.0.7": False}
    assert {host: is_loopback(host) for host in loopback} == loopback


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
