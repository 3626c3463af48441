import http.client
import socket
import threading
import urllib.request
from contextlib import closing

import pytest

from pcore.errors import InputError
from pcore.studio.guard import Guard
from pcore.studio.viewer_page import page_server


def ask(guard: Guard, path: str, *, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=60)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


def test_it_shows_its_page_to_whom_has_the_token_and_nothing_else(free_port: int) -> None:
    guard = Guard(port=free_port)
    shown = {"Cookie": f"{guard.cookie_name}={guard.cookie}"}
    with page_server(guard, b"the page") as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            assert ask(guard, f"/?token={guard.token}")[0] == 200
            assert ask(guard, "/", **shown) == (200, b"the page")
            assert ask(guard, "/")[0] == 403
            assert ask(guard, "/", Host="evil.example", **shown)[0] == 403
            assert ask(guard, "/../x", **shown)[0] == 404
            assert ask(guard, "/", method="POST", **shown)[0] == 501
            with pytest.raises(InputError, match="another pcore page"):
                page_server(guard, b"")
        finally:
            server.shutdown()
            thread.join()


def test_it_listens_at_an_address_of_the_sixth_version() -> None:
    try:
        with closing(socket.socket(socket.AF_INET6)) as probe:
            probe.bind(("::1", 0))
            port = int(probe.getsockname()[1])
    except OSError:
        pytest.skip("this machine has no ::1")
    guard = Guard(host="::1", port=port)
    with page_server(guard, b"the page") as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            with urllib.request.urlopen(guard.url, timeout=60) as answer:
                assert answer.status == 200
        finally:
            server.shutdown()
            thread.join()
