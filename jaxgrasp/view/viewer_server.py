"""Server of pages on a port: by default for this machine and its own pages only, quiet, without uploads or sharing.

Sliders and scene use a socket that any page may open, so requests that a page of another site makes are refused.
A browser lets every page open a WebSocket to every address, this machine's own included, and names the page's site in
`Origin`. A site whose name is made to lead to this machine after its page has loaded (DNS rebinding) has an `Origin`
that agrees with its `Host`, so the host is checked too. Source: RFC 6455, section 10.2; OWASP, "Testing WebSockets".
"""

import contextlib
import errno
import hmac
import http
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from urllib.parse import SplitResult, parse_qs, urlsplit

from jaxgrasp.files.printable import shortened
from jaxgrasp.validation.optional_library import optional_library

DEFAULT_PORTS = {"http": 80, "https": 443}
OWN_NAME = "localhost"
NO_FRAMES = "frame-ancestors 'self'"
"""Content-Security-Policy of the page, so that no other site shows it inside its own and has its sliders clicked."""
COOKIE = "jaxgrasp_token"
"""Cookie that holds the token after the page was opened."""
_constructing = threading.Lock()


class RequestGuard:
    """Check of the headers `Host` and `Origin` for a server that listens on one address."""

    def __init__(self, listens_on: str, allowed_hosts: Sequence[str] = (), token: str = "") -> None:
        """Allow this machine's names for itself, the address that is listened on, and further names.

        An address as a number is safe where others may call, since no site can make one lead elsewhere.

        Args:
            listens_on: the address or name that the server listens on.
            allowed_hosts: further names by which browsers reach it, without a port.
            token: that the page's address must hold, as ``?token=...``, and then a cookie of the browser; none if
                empty.

        Raises:
            ValueError: for a name that holds more than a host.
        """
        self._token = token
        for k, host in enumerate(allowed_hosts):
            if not host or _host(host) is None or _split(host).port is not None:
                raise ValueError(f"allowed_hosts[{k}] is {shortened(host)}: expected a name or address without a port")
        address = _address(listens_on)
        self._takes_addresses = listens_on != OWN_NAME if address is None else not address.is_loopback
        own_names = [OWN_NAME, socket.gethostname()] if self._takes_addresses else [OWN_NAME]
        names = [*own_names, listens_on, *allowed_hosts]
        self._names = {parsed for name in names if (parsed := _host(name)) is not None}

    def refusal(self, host: str | None, origin: str | None) -> str | None:
        """Return why a request is refused, in a line for the person at the browser; None for one that is not.

        Args:
            host: the request's header `Host`; None where it is missing or doubled.
            origin: its header `Origin`; None where it is missing, as in requests of programs and for pages.
        """
        name = None if host is None else _host(host)
        if host is None or name is None:
            return "the request names no host"
        if not self._is_allowed(name):
            return f"{shortened(name)} is not a name of this server: add --allowed-hosts {shortened(name)} if it is"
        if origin is not None and not _is_same_site(origin, host):
            return f"the request comes from a page of {shortened(origin)}, not of this server"
        return None

    def checked(self, process_request: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return `process_request` of websockets' `serve` with the check before it.

        Args:
            process_request: takes a connection and its request; returns a response, or None to open a WebSocket.
        """

        def check_and_process(connection: Any, request: Any) -> Any:
            hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
            # Two of a header are refused: another program on the way may go by the other one.
            refusal = self.refusal(
                hosts[0] if len(hosts) == 1 else None, None if not origins else origins[0] if len(origins) == 1 else ""
            )
            if refusal is None and not self.has_token(request.path, request.headers.get_all("Cookie")):
                refusal = "the address has no valid token: open the address that the command prints"
            if refusal is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refusal}\n")
            response = process_request(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = NO_FRAMES
                if self._token:
                    # The page's own requests have no token in their addresses, and no other site may send it along.
                    response.headers["Set-Cookie"] = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                    response.headers["Referrer-Policy"] = "no-referrer"
            return response

        return check_and_process

    def has_token(self, path: str, cookies: Sequence[str] = ()) -> bool:
        """Return whether a request's path or one of its headers `Cookie` holds the token; True where none is needed."""
        if not self._token:
            return True
        tokens = parse_qs(urlsplit(path).query).get("token", [])
        for cookie in cookies:
            pairs = (pair.strip().partition("=") for pair in cookie.split(";"))
            tokens += [value for name, _, value in pairs if name == COOKIE]
        return any(hmac.compare_digest(token.encode(errors="replace"), self._token.encode()) for token in tokens)

    def _is_allowed(self, name: str) -> bool:
        if name in self._names:
            return True
        address = _address(name)
        return address is not None and (address.is_loopback or self._takes_addresses)


@contextlib.contextmanager
def guarding(guard: RequestGuard, is_ours: Callable[[], bool]) -> Iterator[threading.Event]:
    """Have a server of websockets that starts inside this block check its requests; yield an event, set if one did.

    viser has no argument for it, and calls websockets' `serve` in a thread of its own.

    Args:
        guard: checks the requests.
        is_ours: whether the server starts in the calling thread; those of other threads are left alone.
    """
    import websockets.asyncio.server as module

    is_guarded = threading.Event()
    # Not two at a time: each puts back what it found.
    with _constructing:
        serve = module.serve

        def guarded_serve(*args: Any, process_request: Any = None, **options: Any) -> Any:
            if is_ours() and process_request is not None:
                is_guarded.set()
                process_request = guard.checked(process_request)
            return serve(*args, process_request=process_request, **options)

        module.serve = guarded_serve  # type: ignore[assignment, misc]
        try:
            yield is_guarded
        finally:
            module.serve = serve  # type: ignore[misc]


def _split(host: str) -> SplitResult:
    return urlsplit(f"//{host}")


def _host(text: str) -> str | None:
    """Return the name or address of a `Host` header, without port and brackets; None where it holds anything else."""
    bracketed = f"[{text}]" if text.count(":") > 1 and not text.startswith("[") else text
    try:
        parts = _split(bracketed)
        _ = parts.port
    except ValueError:
        return None
    if parts.hostname is None or parts.username is not None or parts.path or parts.query or parts.fragment:
        return None
    return parts.hostname.lower().rstrip(".")


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _is_same_site(origin: str, host: str) -> bool:
    """Check that an `Origin` names the page that this `Host` serves, over HTTP or through a proxy over HTTPS."""
    try:
        site, served = urlsplit(origin), _split(host)
        port = DEFAULT_PORTS.get(site.scheme)
        return port is not None and _host(site.netloc) == _host(host) and (site.port or port) == (served.port or port)
    except ValueError:
        return False


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
