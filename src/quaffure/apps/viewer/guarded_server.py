"""viser's server for its own page alone.

Any web page that a user has open can send requests to a port of this machine, so each request has to name this machine
(Host, against DNS rebinding) and, where a page sends it, to come from the page that is served here (Origin). Browsers
send what moves widgets and the camera; all else that viser knows, uploads and public tunnels among it, is dropped.
Settings in the query of the page's address are applied where a user opened it, and not where another page loads it.
"""

import asyncio
import ipaddress
import math
import socket
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from typing import Any
from unittest import mock

import msgspec
import websockets.asyncio.server
from viser import ViserServer
from websockets import Headers
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

MOST_BROWSERS = 8
"""Open pages at a time."""
MOST_MESSAGE_BYTES = 1 << 16
MOST_MESSAGES_PER_SECOND = 250.0
"""A browser that sends more waits. A slider that is dragged sends some sixty."""
TAKEN = ("GuiUpdateMessage", "ViewerCameraMessage", "CommandTriggerMessage")
"""Types of the messages that widgets, cameras and keys send."""
BAD_MESSAGE = 1007
HEADERS = {"X-Frame-Options": "DENY", "Content-Security-Policy": "frame-ancestors 'none'"}
"""The page in a frame of another page would take that page's clicks."""

Handler = Callable[[ServerConnection, Request], Response | None]
TakeLink = Callable[[str], str | None]
"""Called with the query of the page's address: applies the settings in it and returns the query without them; None
where it holds none."""

_serving = threading.Lock()


def guarded_server(host: str, port: int, take_link: TakeLink = lambda query: None) -> ViserServer:
    """A server of viser that serves its own page alone.

    Args:
        host: address to listen at.
        port: 0 for any free one.
        take_link: called in the server's thread when a user opens the page by an address with a query.
    """
    serve, guard = websockets.asyncio.server.serve, _Guard(host, take_link)

    def guarded_serve(*arguments: Any, process_request: Handler, **options: Any) -> Any:
        options["max_size"] = MOST_MESSAGE_BYTES
        checked = guard.checking(process_request)
        connection = type("_GuardedConnection", (_Connection,), {"guard": guard})
        return serve(*arguments, process_request=checked, create_connection=connection, **options)

    # viser has no option for any of this; it looks up `serve` once, before its constructor returns.
    with _serving, mock.patch.object(websockets.asyncio.server, "serve", guarded_serve):
        return ViserServer(host, port, verbose=False)


def is_taken(message: bytes) -> bool:
    """Whether a message of a browser is one that the page reads, with finite numbers.

    Raises:
        ValueError: not a message of viser.
    """
    try:
        content = msgspec.msgpack.decode(message)
        is_finite = _is_finite(content)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ValueError("not a message") from error
    if not isinstance(content, dict) or not isinstance(content.get("type"), str):
        raise ValueError("not a message of viser")
    return content["type"] in TAKEN and _sets_values(content) and is_finite


def _is_finite(content: object) -> bool:
    if isinstance(content, dict):
        return all(map(_is_finite, content.values()))
    if isinstance(content, list):
        return all(map(_is_finite, content))
    if isinstance(content, str):  # viser reads the numbers in texts
        try:
            return math.isfinite(float(content))
        except ValueError:
            return True
    return not isinstance(content, float) or math.isfinite(content)


def _sets_values(content: dict[str, Any]) -> bool:
    """Whether an update of a widget changes its value and nothing else: a browser has no say in ranges and texts."""
    updates = content.get("updates")
    return content["type"] != "GuiUpdateMessage" or (isinstance(updates, dict) and set(updates) == {"value"})


class _Guard:
    """What may connect to a server.

    Attributes:
        open: connections of browsers.
    """

    def __init__(self, host: str, take_link: TakeLink) -> None:
        self.open: set[ServerConnection] = set()
        self._take_link = take_link
        self._names = {"localhost", socket.gethostname().lower(), host.lower()}

    def checking(self, handle: Handler) -> Handler:
        def checked(connection: ServerConnection, request: Request) -> Response | None:
            is_page = request.headers.get("Upgrade", "").lower() == "websocket"
            if not self._is_own(request.headers, is_page):
                return _response(HTTPStatus.FORBIDDEN, "This page is served to its own origin alone.\n")
            if is_page and len(self.open) >= MOST_BROWSERS:
                return _response(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_BROWSERS} browsers have this page open.\n")
            response = self._link_response(request) or handle(connection, request)
            if response is None:
                self.open.add(connection)
            else:
                response.headers.update(HEADERS)
            return response

        return checked

    def _link_response(self, request: Request) -> Response | None:
        """For a link to a view: the page without the settings in the address, so that reloading it keeps later changes;
        None for all else."""
        path, _, query = request.path.partition("?")
        if path != "/" or not query or not _is_opened_by_user(request.headers):
            return None
        rest = self._take_link(query)
        if rest is None:
            return None
        response = _response(HTTPStatus.SEE_OTHER, "")
        response.headers["Location"] = f"/?{rest}" if rest else "/"
        response.headers["Cache-Control"] = "no-store"
        return response

    def _is_own(self, headers: Headers, is_page: bool) -> bool:
        """Whether a request names this machine, and comes from the page that is served here where a page sends it."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_named(hosts[0]):
            return False
        return origins == [f"http://{hosts[0]}"] or (not origins and not is_page)

    def _is_named(self, host: str) -> bool:
        """Whether a Host, with or without a port, is a name of this machine or an address, which no DNS can rebind."""
        name = host.lower().rpartition(":")[0] if ":" in host.rpartition("]")[2] else host.lower()
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name in self._names
        return True


class _Connection(ServerConnection):
    """A connection that passes on what the page reads, no faster than a limit."""

    guard: _Guard
    _next = 0.0

    async def recv(self, *arguments: Any, **options: Any) -> Any:
        while True:
            message = await super().recv(*arguments, **options)
            await self._wait()
            try:
                if is_taken(message if isinstance(message, bytes) else b""):
                    return message
            except ValueError:
                await self.close(BAD_MESSAGE)

    async def _wait(self) -> None:
        """Until the message is due; meanwhile the sender's own buffers fill."""
        now = time.monotonic()
        # As many as come in half a second may come at once.
        self._next = max(self._next, now - 0.5) + 1 / MOST_MESSAGES_PER_SECOND
        if self._next > now:
            await asyncio.sleep(self._next - now)

    def connection_lost(self, exc: Exception | None) -> None:
        self.guard.open.discard(self)
        super().connection_lost(exc)


def _is_opened_by_user(headers: Headers) -> bool:
    """Whether a user opened an address in a tab: no image, script or frame of another page, no prefetch, and no page
    that sends the tab elsewhere by itself."""
    if "Sec-Purpose" in headers:
        return False
    if "Sec-Fetch-Dest" not in headers:  # browsers send these headers over HTTPS and to this machine alone
        return headers.get("Accept", "").startswith("text/html")
    is_typed_or_own = headers.get("Sec-Fetch-Site") in ("none", "same-origin")
    return headers["Sec-Fetch-Dest"] == "document" and (is_typed_or_own or headers.get("Sec-Fetch-User") == "?1")


def _response(status: HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)
