"""The page's web server on this machine: static files and one websocket per window.

It is bound to 127.0.0.1 only. The address contains a random token, which every request must have. A request from a
page of another origin, or by another host name (DNS rebinding), is refused. The page loads nothing from elsewhere.
"""

import asyncio
import hmac
import json
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from transopt.base.errors import InputError
from transopt.web.crew import Crew
from transopt.web.frames import parted
from transopt.web.service import Service
from transopt.web.session import Session
from transopt.web.upload import MOST_UPLOAD_BYTES

HOST = "127.0.0.1"
MISSING = "the page needs starlette, uvicorn and websockets: pip install 'transopt[page]'"
STATIC = Path(__file__).parent / "static"
KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
MOST_WINDOWS = 16
FRAME_BYTES = MOST_UPLOAD_BYTES + 2**20
USUAL_PORT = 8037  # a fixed port keeps the origin, under which the browser stores own taps, over restarts
READY_S = 10.0
SWITCH_S = 5e-4
REFUSED = 4403  # close code of a websocket that does not belong to the page

Asgi = Callable[..., Any]


def check_extra() -> None:
    """Check that the packages of the extra `page` are installed.

    Raises
    ------
    InputError : one cannot be imported; the message says what to install.
    """
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ImportError:
        raise InputError(MISSING) from None


class Guard:
    """Middleware that refuses requests which do not come from the page's own window.

    Parameters
    ----------
    inner : the application behind it.
    token : first part of every path.
    port : port of the address; requests by other hosts and origins are refused.
    """

    def __init__(self, inner: Asgi, token: str, port: int) -> None:
        self._inner, self._token = inner, token
        self._hosts = {f"{HOST}:{port}", f"localhost:{port}"}
        self._origins = {f"http://{host}" for host in self._hosts}
        self._policy = (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
            f"connect-src 'self' {' '.join(f'ws://{host}' for host in sorted(self._hosts))}; base-uri 'none'; "
            "form-action 'none'; frame-ancestors 'none'"
        )

    def refused(self, scope: dict[str, Any]) -> bool:
        """Whether to refuse a request."""
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        origin = headers.get(b"origin")
        if headers.get(b"host", "") not in self._hosts:
            return True
        if (origin is None and scope["type"] == "websocket") or (origin is not None and origin not in self._origins):
            return True
        if headers.get(b"sec-fetch-site", "none") not in ("none", "same-origin"):
            return True
        given = scope["path"].split("/")[1].encode()
        return not hmac.compare_digest(given, self._token.encode())

    async def __call__(self, scope: dict[str, Any], receive: Asgi, send: Asgi) -> None:
        if self.refused(scope):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": REFUSED})
                return
            await send({"type": "http.response.start", "status": 403, "headers": [(b"content-type", b"text/plain")]})
            await send({"type": "http.response.body", "body": b"open the address that `transopt page` printed\n"})
            return

        async def sealed(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                sealing = {
                    b"content-security-policy": self._policy.encode(),
                    b"x-content-type-options": b"nosniff",
                    b"referrer-policy": b"no-referrer",
                    b"cross-origin-resource-policy": b"same-origin",
                    b"cache-control": b"no-store",
                }
                message = {**message, "headers": [*message["headers"], *sealing.items()]}
            await send(message)

        await self._inner(scope, receive, sealed)


def application(opener: Callable[[], Service], crew: Crew, token: str, port: int) -> Asgi:
    """The page as an ASGI application.

    Parameters
    ----------
    opener : creates the service of each window.
    crew : solves the taps of all windows.
    """
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import FileResponse, Response
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket, WebSocketDisconnect

    windows: set[Session] = set()
    files = {path.name: path for path in STATIC.iterdir() if path.suffix in KINDS}

    async def static(request: Request) -> Response:
        name = request.path_params["name"]
        # The name is looked up in the list of static files; a path from a request is never opened.
        if name not in files:
            return Response("no such file\n", status_code=404, media_type="text/plain")
        return FileResponse(files[name], media_type=KINDS[files[name].suffix])

    async def window(connection: WebSocket) -> None:
        await connection.accept()
        if len(windows) >= MOST_WINDOWS:
            words = f"{MOST_WINDOWS} windows are open: close one of them, and load this page again"
            await connection.send_text(json.dumps({"type": "refused", "about": "open", "words": words}))
            await connection.close()
            return
        loop, outgoing = asyncio.get_running_loop(), asyncio.Queue[str | bytes]()

        def send(message: str | bytes) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(outgoing.put_nowait, message)

        session = Session(opener, send, crew)
        windows.add(session)

        async def deliver() -> None:
            while True:
                message = await outgoing.get()
                if isinstance(message, str):
                    await connection.send_text(message)
                else:
                    await connection.send_bytes(message)

        delivery = asyncio.create_task(deliver())
        session.start()
        try:
            while True:
                received = await connection.receive()
                if received["type"] == "websocket.disconnect":
                    break
                try:
                    if received.get("bytes") is not None:
                        session.put(*parted(received["bytes"]))
                    else:
                        message = json.loads(received["text"])
                        if not isinstance(message, dict):
                            raise InputError("a message of the page cannot be read: load the page again")
                        session.put(message)
                except (InputError, ValueError) as error:
                    send(json.dumps({"type": "refused", "about": "message", "words": str(error)}))
        except WebSocketDisconnect:
            pass
        finally:
            delivery.cancel()
            session.end()
            windows.discard(session)

    async def front(request: Request) -> Response:
        return FileResponse(files["page.html"], media_type=KINDS[".html"])

    routes = [
        WebSocketRoute(f"/{token}/window", window),
        Route(f"/{token}/", front),
        Route(f"/{token}/{{name}}", static),
    ]
    return Guard(Starlette(routes=routes), token, port)


class Server:
    """The server of a page; `address` is to be opened in a browser.

    Parameters
    ----------
    opener : creates the service of each window.
    port : 0 for any free port; None for the usual one, or any if that is taken.
    token : secret part of the address; random by default.

    Raises
    ------
    InputError : the extra is missing, or the port is taken.
    """

    def __init__(self, opener: Callable[[], Service], port: int | None = 0, token: str = "") -> None:
        check_extra()
        import uvicorn

        self._socket = _bound(port)
        self.port = int(self._socket.getsockname()[1])
        self.token = token or secrets.token_urlsafe()
        self.address = f"http://{HOST}:{self.port}/{self.token}/"
        self._crew = Crew()
        self._server = uvicorn.Server(
            uvicorn.Config(
                application(opener, self._crew, self.token, self.port),
                log_level="critical",
                access_log=False,
                lifespan="off",
                http="h11",
                ws="websockets-sansio",
                ws_max_size=FRAME_BYTES,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=0,
                server_header=False,
            )
        )
        self._thread: threading.Thread | None = None

    def serve(self) -> None:
        """Serve until a signal ends the process."""
        # Windows' threads compute while this one sends. With Python's default switch interval of 5 ms an answer would
        # wait for the interpreter longer than it takes to compute.
        sys.setswitchinterval(SWITCH_S)
        self._crew.start()
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self._socket.close()
            self._crew.end()

    def start(self) -> None:
        """Serve in a thread of its own."""
        self._thread = threading.Thread(target=self.serve, name="page server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread of `start`."""
        self._server.should_exit = True
        if self._thread is not None:
            self._thread.join(READY_S)


def _bound(port: int | None) -> socket.socket:
    """A socket that listens at the given port; for None at the usual one, or any if that is taken."""
    listening = socket.socket()
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, USUAL_PORT if port is None else port))
        listening.listen()
    except (OSError, OverflowError) as error:
        listening.close()
        if port is None:
            return _bound(0)
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"--port {port}: cannot be used ({reason}): choose another, or leave it out") from None
    return listening
