"""The page's server, in a child process of the run: HTTP, web sockets, and a hub for all viewers.

Each viewer gets the newest of everything; no queue grows for a slow one.
"""

import asyncio
import errno
import socket
import threading
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from verify.core.processes import FAILED, READY, ParentLine, ParentLostError, lower_priority
from verify.live.page.access import COOKIE, HEADERS, PageAccess

MAX_HISTORY_ROWS = 1800  # rows for a viewer who comes later: a minute at 30 a second
MAX_WAITING_MESSAGES = 200  # messages a viewer may lag behind; a browser that sleeps is let go


class Viewer:
    """One browser: text in order, of pictures only the newest a side."""

    def __init__(self) -> None:
        self._texts: deque[str] = deque()
        self._pictures: dict[int, bytes] = {}
        self._wake = asyncio.Event()
        self.lagging = False

    def text(self, message: str) -> None:
        """Put a message in line."""
        if len(self._texts) >= MAX_WAITING_MESSAGES:
            self.lagging = True
        else:
            self._texts.append(message)
        self._wake.set()

    def picture(self, side: int, data: bytes) -> None:
        """Replace the picture that was not sent yet."""
        self._pictures[side] = data
        self._wake.set()

    async def next(self) -> list[str | bytes]:
        """Wait for something to send."""
        await self._wake.wait()
        self._wake.clear()
        messages: list[str | bytes] = [*self._texts, *self._pictures.values()]
        self._texts.clear()
        self._pictures.clear()
        return messages


class ViewerHub:
    """All viewers, and what one who comes later has to know."""

    def __init__(self, counted: Callable[[int], None]) -> None:
        self._viewers: set[Viewer] = set()
        self._counted = counted
        self._latest: dict[str, str] = {}  # by kind, of messages of which the newest is enough
        self._rows: deque[str] = deque(maxlen=MAX_HISTORY_ROWS)
        self._pictures: dict[int, bytes] = {}
        self.metrics = ""

    def enter(self) -> Viewer:
        """Let a viewer in and tell it what there was."""
        viewer = Viewer()
        for kind in ("hello", "state", "alarms"):
            if kind in self._latest:
                viewer.text(self._latest[kind])
        if self._rows:
            viewer.text('{"type":"rows","past":true,"rows":[' + ",".join(self._rows) + "]}")
        for side, data in self._pictures.items():
            viewer.picture(side, data)
        self._viewers.add(viewer)
        self._counted(len(self._viewers))
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Forget a viewer."""
        self._viewers.discard(viewer)
        self._counted(len(self._viewers))

    def message(self, kind: str, text: str) -> None:
        """Pass on a message."""
        if kind == "metrics":
            self.metrics = text
            return
        if kind != "rows":
            self._latest[kind] = text
        if kind == "hello":
            self._rows.clear()
        for viewer in self._viewers:
            viewer.text(text)

    def rows(self, rows: list[str]) -> None:
        """Pass on rows, each an object in JSON."""
        self._rows.extend(rows)
        self.message("rows", '{"type":"rows","rows":[' + ",".join(rows) + "]}")

    def picture(self, side: int, data: bytes) -> None:
        """Pass on a picture with its LEDs."""
        self._pictures[side] = data
        for viewer in self._viewers:
            viewer.picture(side, data)


STATIC = Path(__file__).with_name("static")
TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
CONTENT_TYPES = {
    file.relative_to(STATIC).as_posix(): TYPES[suffix]
    for suffix in TYPES
    for file in STATIC.rglob(f"*.{suffix}")
}
POLICY_VIOLATION = 1008  # of web sockets: policy violation
TRY_AGAIN = 1013
MAX_MESSAGE_BYTES = 1 << 12  # bytes from a viewer, who has a word to say, or a line
CONNECTION_TIMEOUT = 10.0  # s for all requests on a connection that has become no web socket

NextHandler = Callable[[Request], Awaitable[Response]]
MessageCallback = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ViewerMessages:
    """What viewers may say; anything else is not listened to."""

    commands: frozenset[str] = frozenset()
    inputs: frozenset[str] = frozenset()  # first words; what more there is follows after a space


def application(hub: ViewerHub, access: PageAccess, take_message: MessageCallback) -> Starlette:
    """Make the application: the page, its files, its web socket, and metrics."""

    async def guarded(request: Request, go_on: NextHandler) -> Response:
        response = _move_token_to_cookie(request, access) or _access_refusal(request, access)
        if response is None:
            response = await go_on(request)
        response.headers.update(HEADERS)
        return response

    async def file(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in CONTENT_TYPES:
            return PlainTextResponse("There is no such page.", status_code=404)
        return FileResponse(STATIC / name, media_type=CONTENT_TYPES[name])

    async def metrics(_request: Request) -> Response:
        return PlainTextResponse(hub.metrics, media_type="text/plain; version=0.0.4")

    async def live(socket: WebSocket) -> None:
        if access.refusal(socket.headers, socket.cookies.get(COOKIE), script=True) is not None:
            await socket.close(POLICY_VIOLATION)
            return
        await socket.accept()
        await _send_to_viewer(socket, hub, take_message)

    app = Starlette(
        routes=[
            Route("/", file),
            Route("/metrics", metrics),
            WebSocketRoute("/live", live),
            Route("/{name:path}", file),
        ]
    )
    app.add_middleware(BaseHTTPMiddleware, dispatch=guarded)
    return app


def _move_token_to_cookie(request: Request, access: PageAccess) -> Response | None:
    """Move a right token from the address into a cookie, so that it is seen and sent no more."""
    given = request.query_params.get("token")
    if request.url.path != "/" or not access.matches(given) or given is None:
        return None
    response = RedirectResponse("/", status_code=303)
    response.set_cookie(COOKIE, given, httponly=True, samesite="strict")
    return response


def _access_refusal(request: Request, access: PageAccess) -> Response | None:
    shown = request.cookies.get(COOKIE)
    word, _, bearer = request.headers.get("authorization", "").partition(" ")
    token = bearer if word.lower() == "bearer" else shown
    refusal = access.refusal(request.headers, token, script=False)
    return None if refusal is None else PlainTextResponse(f"Refused: {refusal}.\n", 403)


async def _send_to_viewer(socket: WebSocket, hub: ViewerHub, take_message: MessageCallback) -> None:
    """Send until the viewer leaves, or cannot keep up."""
    viewer = hub.enter()
    gone = asyncio.create_task(_receive_from_viewer(socket, take_message))
    try:
        while not gone.done():
            news = asyncio.create_task(viewer.next())
            await asyncio.wait({news, gone}, return_when=asyncio.FIRST_COMPLETED)
            if not news.done():
                news.cancel()
                break
            for message in news.result():
                if isinstance(message, str):
                    await socket.send_text(message)
                else:
                    await socket.send_bytes(message)
            if viewer.lagging:
                await socket.close(TRY_AGAIN)
                break
    except (WebSocketDisconnect, RuntimeError, OSError):
        pass  # it left while something was on its way
    finally:
        gone.cancel()
        hub.leave(viewer)


async def _receive_from_viewer(socket: WebSocket, take_message: MessageCallback) -> None:
    """Wait for the viewer to leave, or to send bytes, which no page does; pass on what it says."""
    with suppress(WebSocketDisconnect, RuntimeError, KeyError):  # KeyError: bytes
        while True:
            take_message(await socket.receive_text())


class _Server(uvicorn.Server):
    """Leaves signals alone: the run ends this process."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take no signal."""
        yield


class TimedHttp(H11Protocol):
    """Closes a connection in time: uvicorn itself waits for ever for the rest of a request."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin, and set its end."""
        super().connection_made(transport)
        self.loop.call_later(CONNECTION_TIMEOUT, self._end)

    def _end(self) -> None:
        if self.transport.get_protocol() is self:  # else it is a viewer's web socket by now
            self.transport.abort()


def serve(line: ParentLine, access: PageAccess, messages: ViewerMessages) -> None:
    """Serve until the run ends; the target of the server's process.

    The line goes to the run; port 0 takes a free one, and READY's value is the port. `messages`:
    what viewers may send.
    """
    if messages == ViewerMessages():  # nobody can send "stop": nothing is urgent
        lower_priority()
    family = socket.AF_INET6 if ":" in access.address else socket.AF_INET
    try:
        listening = socket.create_server((access.address, access.port), family=family)
    except OSError as error:
        taken = error.errno in (errno.EADDRINUSE, errno.EACCES)
        here = f"port {access.port} is taken or not allowed"
        line.send(FAILED, here if taken else f"this computer has no address {access.address}")
        return
    access = replace(access, port=listening.getsockname()[1])
    asyncio.run(_serve(line, access, messages, listening))


async def _serve(
    line: ParentLine, access: PageAccess, messages: ViewerMessages, listening: socket.socket
) -> None:
    loop = asyncio.get_running_loop()

    def send(kind: str, value: Any) -> None:
        with suppress(ParentLostError):
            line.send(kind, value)

    def take(text: str) -> None:
        word, _, more = text.partition(" ")
        if text in messages.commands:
            send("command", text)
        elif word in messages.inputs:
            send("input", (word, more))

    hub = ViewerHub(lambda viewers: send("viewers", viewers))
    special: dict[str, Callable[..., None]] = {"rows": hub.rows, "picture": hub.picture}
    config = uvicorn.Config(
        application(hub, access, take),
        log_level="critical",
        access_log=False,
        lifespan="off",
        http=TimedHttp,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,  # JPEGs do not get smaller
        timeout_graceful_shutdown=1,
        server_header=False,
    )
    server = _Server(config)

    def receive() -> None:
        """Pass on what the run sends; end with it."""
        with suppress(ParentLostError):
            while True:
                kind, *content = line.receive()
                take = special.get(kind) or partial(hub.message, kind)
                loop.call_soon_threadsafe(take, *content)
        server.should_exit = True

    line.send(READY, access.port)
    threading.Thread(target=receive, name="feed", daemon=True).start()
    await server.serve([listening])
