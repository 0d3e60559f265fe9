"""``potmesil live``: the viewer as a page that a browser on the same machine shows.

Only 127.0.0.1 is listened on, and every address begins with a token that nobody can guess; what
lacks it, or was asked for by another name or from another page, is refused. Pictures are formed by
the thread that :meth:`Live.run` is called in, for Dr.Jit is for one; the connection is another's.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
import struct
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import TYPE_CHECKING, Any

from .._backend import alone
from .._threads import HostThread
from .extra import STATIC, require_extra
from .mailbox import Mailbox
from .view import Answer, Viewer

if TYPE_CHECKING:
    from aiohttp import web

HOST = "127.0.0.1"
"""The machine itself, by a name that no name server can change."""

FILES = {
    "": ("live.html", "text/html"),
    "live.js": ("live.js", "text/javascript"),
    "viewer.js": ("viewer.js", "text/javascript"),
    "viewer.css": ("viewer.css", "text/css"),
    "icon.svg": ("icon.svg", "image/svg+xml"),
}
"""What there is, by the end of its address: the file, and its type."""

LONGEST_QUESTION = 1 << 14
"""Bytes of a message of a page, at most."""

TURN = 0.25
"""Seconds after which a thread that waits looks whether it is to end."""

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self' ws://{host}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
"""What is said with every answer."""


def require_server() -> None:
    """Raise ``ImportError`` without the extra ``interactive``."""
    require_extra("aiohttp")


class Live:
    """A server of one view, for pages on this machine.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``view``                      what is shown; it is used by the thread of :meth:`run` alone
    ``port``                      that is listened on; 0 (default) for one that is free
    ============================  ==========================================================

    Raises ``ImportError`` without the extra ``interactive``.
    """

    def __init__(self, view: Viewer, port: int = 0) -> None:
        require_server()
        self._view = view
        self._about = view.about
        self._port = port
        self._token = secrets.token_urlsafe(24)
        self._mailbox = Mailbox()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ending = asyncio.Event()
        self._begun = threading.Event()
        self._error: BaseException | None = None
        self._files = {name: (STATIC / of).read_bytes() for name, (of, _) in FILES.items()}
        self._ended = False

    @property
    def address(self) -> str:
        """What a browser is to open, once :meth:`listening` has begun."""
        return f"http://{HOST}:{self._port}/{self._token}/"

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Pages can connect within the block. Raises ``OSError`` if the port is not free."""
        self._loop = loop = asyncio.new_event_loop()
        thread = HostThread(target=self._listen, args=(loop,), name="potmesil_mi live")
        thread.start()
        try:
            self._begun.wait()
            if self._error is not None:
                raise self._error
            yield
        finally:
            self.end()
            with contextlib.suppress(RuntimeError):  # It has ended by itself.
                loop.call_soon_threadsafe(self._ending.set)
            thread.join()

    def run(self, seconds: float = math.inf) -> None:
        """Answer what pages ask for so long, until :meth:`end` is called or Ctrl-C is pressed.

        It is to be called within :meth:`listening`.
        """
        assert self._loop is not None
        until = time.monotonic() + seconds
        with alone():
            while not self._ended and (left := until - time.monotonic()) > 0:
                taken = self._mailbox.take(min(TURN, left))
                if taken is not None:
                    page, message = taken
                    self._loop.call_soon_threadsafe(page.send, self._view.answer(message))

    def end(self) -> None:
        """Let :meth:`run` return; may be called by another thread."""
        self._ended = True

    # ------------------------------------------------------------ the thread of the connection

    def _listen(self, loop: asyncio.AbstractEventLoop) -> None:
        try:
            loop.run_until_complete(self._serve())
        except BaseException as error:
            self._error = error
        finally:
            loop.close()
            self._begun.set()

    async def _serve(self) -> None:
        from aiohttp import web

        app = web.Application(middlewares=[self._guard()], client_max_size=LONGEST_QUESTION)
        app.router.add_get(f"/{self._token}/socket", self._connected)
        app.router.add_get(f"/{self._token}/{{name:[a-z.]*}}", self._file)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.5)
        await runner.setup()
        try:
            site = web.TCPSite(runner, HOST, self._port)
            await site.start()
            self._port = runner.addresses[0][1]
            self._begun.set()
            await self._ending.wait()
        finally:
            await runner.cleanup()

    def _guard(self) -> Any:
        """What looks at every request first: by which name, with which token, from which page."""
        from aiohttp import web

        @web.middleware
        async def guard(
            request: web.Request,
            handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
        ) -> web.StreamResponse:
            host = f"{HOST}:{self._port}"
            token = request.path.lstrip("/").partition("/")[0].encode(errors="replace")
            allowed = secrets.compare_digest(token, self._token.encode())
            # Another name may be that of a page elsewhere whose address was changed to this one.
            allowed &= request.host == host
            allowed &= request.headers.get("Origin", f"http://{host}") == f"http://{host}"
            response: web.StreamResponse
            try:
                response = await handler(request) if allowed else web.Response(status=403)
            except web.HTTPException as error:
                response = web.Response(status=error.status)
            if not response.prepared:
                response.headers.update(
                    {name: of.format(host=host) for name, of in HEADERS.items()}
                )
            return response

        return guard

    async def _file(self, request: web.Request) -> web.StreamResponse:
        from aiohttp import web

        name = request.match_info["name"]
        if name not in FILES:
            raise web.HTTPNotFound
        return web.Response(body=self._files[name], content_type=FILES[name][1], charset="utf-8")

    async def _connected(self, request: web.Request) -> web.StreamResponse:
        """A page: it is told what there is, and asks until it goes."""
        from aiohttp import WSMsgType, web

        if request.headers.get("Origin") is None:  # Only browsers' pages are to connect.
            return web.Response(status=403)
        socket = web.WebSocketResponse(max_msg_size=LONGEST_QUESTION, compress=False)
        await socket.prepare(request)
        page = _Page(socket)
        ended = asyncio.ensure_future(self._closed_at_end(socket))
        try:
            await socket.send_str(json.dumps({"about": self._about}))
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    self._mailbox.put(page, _read(message.data))
        finally:
            ended.cancel()
            self._mailbox.forget(page)
            page.gone()
        return socket

    async def _closed_at_end(self, socket: web.WebSocketResponse) -> None:
        await self._ending.wait()
        await socket.close()


class _Page:
    """A page that is connected, as the thread of the connection knows it."""

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self._socket = socket
        self._sending: set[asyncio.Task[None]] = set()

    def send(self, answer: Answer) -> None:
        """Send an answer: the length of its message, the message, the picture."""
        text = json.dumps(answer.message).encode()
        task = asyncio.ensure_future(
            self._send(struct.pack("<I", len(text)) + text + answer.picture)
        )
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)

    def gone(self) -> None:
        """Send no more."""
        for task in list(self._sending):
            task.cancel()

    async def _send(self, data: bytes) -> None:
        with contextlib.suppress(ConnectionError):  # It may have gone meanwhile.
            await self._socket.send_bytes(data)


def _read(text: str) -> Any:
    """What a page asks; what is no JSON is refused as all that is not an object is."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None
