"""A server of one page that nobody can change: `pcore view RUN`."""

from __future__ import annotations

from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from pcore.studio.guard import HEADERS, REFUSED, WELCOME, Guard
from pcore.studio.ports import SERVER, check_port, family_of


def page_server(guard: Guard, content: bytes) -> ThreadingHTTPServer:
    """Make a server of a page; `serve_forever` runs it, another thread may `shutdown` it.

    Args:
        guard: who may see it, and where it listens.
        content: the page.

    Raises:
        InputError: its port is taken.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Answer with the page, or say no."""
            headers = {name.lower(): value for name, value in self.headers.items()}
            if guard.refusal(headers, self.path, socket=False) is not None:
                self._answer(REFUSED, b"refused\n", kind="text/plain")
            elif guard.brings_token(self.path):
                self._answer(200, WELCOME, cookie=guard.set_cookie)
            elif self.path == "/":
                self._answer(200, content)
            else:
                self._answer(404, b"not found\n", kind="text/plain")

        def version_string(self) -> str:
            return SERVER

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

        def _answer(
            self, status: int, body: bytes, *, kind: str = "text/html", cookie: str | None = None
        ) -> None:
            self.send_response(status)
            for name, value in HEADERS:
                self.send_header(name, value)
            if cookie is not None:
                self.send_header("Set-Cookie", cookie)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    check_port(guard.host, guard.port)

    class Server(ThreadingHTTPServer):
        address_family = family_of(guard.host, guard.port)

    return Server((guard.host, guard.port), Handler)
