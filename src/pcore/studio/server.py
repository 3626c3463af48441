"""The page's server: viser behind a guard, without what this project has no use for.

viser has no public place for a check of requests, so that its version is pinned (pyproject.toml)
and the tests talk to it through sockets of their own.
"""

from __future__ import annotations

import contextlib
import io
import json
import threading
from collections.abc import Generator
from http import HTTPStatus
from importlib import import_module
from importlib.resources import files
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from pcore.packages import package
from pcore.studio.guard import HEADERS, LARGEST_MESSAGE, REFUSED, WELCOME, Guard
from pcore.studio.ports import SERVER, check_port

if TYPE_CHECKING:
    import viser

_UNWANTED = (
    "ShareUrlRequest",
    "ShareUrlDisconnect",
    "FileTransferStartUpload",
    "FileTransferPart",
)
"""Messages that open a tunnel to the internet, or put files here; nobody answers them."""
_TITLE = b"<title>Viser</title>"
"""Of viser's page; ours takes its place, with what is seen until the page is connected."""
_START = threading.Lock()


def open_server(guard: Guard, *, label: str) -> viser.ViserServer:
    """Start a page that only those can see whom the guard lets in.

    Args:
        guard: who that is, and where the page is.
        label: title of the panel.

    Raises:
        DependencyError: viser is not installed.
        InputError: the port is taken.
    """
    require_viser()
    import viser

    check_port(guard.host, guard.port)
    # viser greets on stdout; the library is silent.
    with _START, _guarded(guard), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=guard.host, port=guard.port, label=label, verbose=False)
    if server.get_port() != guard.port:  # Taken since we looked; viser then goes on to the next.
        server.stop()
        check_port(guard.host, guard.port)
    _silence(server)
    return server


def paint(gui: Any, *, dark: bool) -> None:
    """Choose the colours of the panel, of a server or of one tab."""
    gui.configure_theme(
        show_share_button=False, show_logo=False, control_width="medium", dark_mode=dark
    )


def run_script(server: Any) -> None:
    """Let every tab run the page's script and wear its style, which viser has no public way for."""
    from viser import _messages

    page = files("pcore.studio").joinpath("page")
    style = json.dumps(page.joinpath("studio.css").read_text())
    source = f"const STYLE = {style};\n{page.joinpath('hands.js').read_text()}"
    server._websock_server.queue_message(_messages.RunJavascriptMessage(source))


def sweep(server: viser.ViserServer) -> None:
    """Forget messages of widgets that are gone; viser itself does that when tabs join alone."""
    server._run_garbage_collector()  # pyright: ignore[reportPrivateUsage]


def require_viser() -> None:
    """Raise DependencyError where viser is not installed."""
    package("viser", extra="studio", need="the studio needs")


def _silence(server: Any) -> None:
    """Take out the handlers of messages that nobody may send."""
    sockets = server._websock_server
    for kind in list(sockets._incoming_handlers):
        if kind.__name__ in _UNWANTED:
            del sockets._incoming_handlers[kind]
    paint(server.gui, dark=False)
    server.gui.main_panel.dock_right()


@contextlib.contextmanager
def _guarded(guard: Guard) -> Generator[None]:
    """While viser starts, what it calls `websockets` is the same behind the guard."""
    infra: Any = import_module("viser.infra._infra")
    known: Any = infra.websockets
    served = known.asyncio.server
    stand_in = SimpleNamespace(
        asyncio=SimpleNamespace(
            server=SimpleNamespace(
                serve=_serve_behind(guard, served.serve), ServerConnection=served.ServerConnection
            )
        ),
        datastructures=known.datastructures,
        exceptions=known.exceptions,
    )
    infra.websockets = stand_in
    try:
        yield
    finally:
        infra.websockets = known


def _serve_behind(guard: Guard, serve: Any) -> Any:
    """`websockets.asyncio.server.serve` with a guard before its `process_request`."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    head = files("pcore.studio").joinpath("page", "head.html").read_bytes()

    def answer(status: HTTPStatus, body: bytes, *more: tuple[str, str]) -> Any:
        headers = Headers([*HEADERS, *more, ("Content-Length", str(len(body)))])
        return Response(status.value, status.phrase, headers, body)

    def guarded(handler: Any, host: str, port: int, **options: Any) -> Any:
        proceed = options.pop("process_request")

        def process(connection: Any, request: Any) -> Any:
            headers = {name.lower(): value for name, value in request.headers.raw_items()}
            socket = "upgrade" in headers
            if guard.refusal(headers, request.path, socket=socket) is not None:
                return answer(REFUSED, b"refused\n", ("Content-Type", "text/plain"))
            if not socket and guard.brings_token(request.path):
                kind = ("Content-Type", "text/html; charset=utf-8")
                return answer(HTTPStatus.OK, WELCOME, kind, ("Set-Cookie", guard.set_cookie))
            if "Accept-Encoding" in request.headers:  # Packed as it is, it could not be changed.
                del request.headers["Accept-Encoding"]
            found = proceed(connection, request)
            if found is not None:
                if found.headers.get("Content-Type", "").startswith("text/html"):
                    found.body = found.body.replace(_TITLE, head, 1)
                    found.headers.pop("Content-Length", None)
                    found.headers["Content-Length"] = str(len(found.body))
                for name, value in HEADERS:
                    found.headers[name] = value
            return found

        options |= {"max_size": LARGEST_MESSAGE, "server_header": SERVER}
        return serve(handler, host, port, process_request=process, **options)

    return guarded
