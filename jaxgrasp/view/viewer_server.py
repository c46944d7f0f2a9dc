"""Server of pages on a port: by default for this machine only, for its own pages only, quiet, without uploads or
sharing."""

import contextlib
import errno
import ipaddress
import logging
import socket
import threading
from collections.abc import Iterator, Sequence
from typing import Any

from jaxgrasp.validation.optional_library import optional_library
from jaxgrasp.view.request_guard import RequestGuard, guarding

MISSING = "the live scene needs viser: pip install 'jaxgrasp[view]'"
UNSAFE = "pages of any site could use it, so it was stopped"
HOST, PORT = "127.0.0.1", 8080
TRIED = 200
"""Number of ports that are tried to find a free port."""


@contextlib.contextmanager
def serving(
    host: str = HOST, port: int = PORT, label: str = "jaxgrasp", allowed_hosts: Sequence[str] = (), token: str = ""
) -> Iterator[Any]:
    """Run a viser server until the block ends, which refuses what pages of other sites ask for.

    Args:
        host: the address that it listens on.
        port: its port, or 0 for any that is free.
        label: the heading of its panel.
        allowed_hosts: names by which browsers reach it, besides localhost, addresses of this machine and ``host``.
        token: that the page's address must hold; none if empty.

    Raises:
        OSError: for a port that is taken, with one that is free, and for an address that this machine has not.
        ValueError: for an allowed host that is none.
        ImportError: viser is not installed.
    """
    server_class = quiet_viser()
    guard = RequestGuard(host, allowed_hosts, token)
    check_free(host, port)
    server = server_class(guard, host=host, port=port, label=label, verbose=False)
    try:
        if port not in (0, server.get_port()):
            raise OSError(taken(host, port))
        refuse_uploads(server)
        yield server
    finally:
        server.stop()


def is_loopback(host: str) -> bool:
    """Return whether an address is that of this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def page_address(host: str, port: int, token: str = "") -> str:
    """Return the address of a page for a browser; that of a server on all addresses has this machine's name."""
    try:
        address = ipaddress.ip_address(host)
        name = socket.gethostname() if address.is_unspecified else f"[{host}]" if address.version == 6 else host
    except ValueError:
        name = host
    return f"http://{name}:{port}" + (f"/?token={token}" if token else "")


def quiet_viser() -> Any:
    """Return the class of servers that print nothing, refuse foreign requests, and share no scene elsewhere."""
    optional_library("viser", missing=MISSING)
    import rich
    import viser

    # It says where it listens, when it stops and which browser is of another version; we say what a person needs. What
    # is no request, or ends in its middle, is nothing to report.
    rich.get_console().quiet = True
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)

    class LocalServer(viser.ViserServer):
        def __init__(self, guard: RequestGuard, **options: Any) -> None:
            def is_ours() -> bool:
                return threading.current_thread() is self._websock_server._server_thread

            with guarding(guard, is_ours) as is_guarded:
                super().__init__(**options)
            if not is_guarded.is_set():
                self.stop()
                raise RuntimeError(
                    f"viser {viser.__version__} starts its server in another way than viser 1.1 does: {UNSAFE}"
                )

        def request_share_url(self, verbose: bool = True) -> None:
            """Refuse a share URL: any browser may request it, and it would open a tunnel through an internet host."""

    return LocalServer


def refuse_uploads(server: Any) -> None:
    """Reject files that a browser sends: the page has no button for them, and they would only fill memory."""
    from viser import _messages

    def refuse(side: Any) -> None:
        for kind in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
            side.gui._websock_interface.unregister_handler(kind)

    refuse(server)
    # A browser's own handlers are made when it connects, before it can have sent anything.
    server.on_client_connect(refuse)


def check_free(host: str, port: int, option: str = "--port") -> None:
    """Raise OSError, with another one for the command's ``option``, where a port is taken."""
    if not 0 <= port < 65536:
        raise ValueError(f"port is {port}: expected 0 to 65535")
    if port and (fault := _fault(host, port)) is not None:
        raise OSError(taken(host, port, option) if fault == "taken" else f"cannot listen at {host}:{port}: {fault}")


def taken(host: str, port: int, option: str = "--port") -> str:
    """Return the message on a port in use, with the next free port if there is one."""
    free = next(
        (candidate for candidate in range(port + 1, min(port + TRIED, 65536)) if _fault(host, candidate) is None), None
    )
    hint = "" if free is None else f"; {free} is free: {option} {free}"
    return f"port {port} of {host} is in use{hint}"


def _fault(host: str, port: int) -> str | None:
    """Return the reason why a port cannot be listened on: "taken" or the system's message; None if it is free."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except OSError as error:
        return "taken" if error.errno == errno.EADDRINUSE else (error.strerror or str(error))
    return None
