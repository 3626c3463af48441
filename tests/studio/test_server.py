"""Section 6 of the security table, by sockets of our own against a running page."""

import asyncio
import http.client
import random
import socket
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

from pcore.errors import InputError
from pcore.studio.guard import LARGEST_MESSAGE, Guard
from pcore.studio.ports import check_port

viser = pytest.importorskip("viser", reason="the extra studio is not installed")
from websockets.asyncio.client import connect  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402

from pcore.studio.server import open_server  # noqa: E402


@pytest.fixture(scope="module")
def guard() -> Iterator[Guard]:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    guard = Guard(port=port)
    server = open_server(guard, label="test")
    server.scene.add_frame("/secret")
    yield guard
    server.stop()


def get(guard: Guard, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=60)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}, body


def cookie(guard: Guard) -> str:
    return f"{guard.cookie_name}={guard.cookie}"


async def joined(guard: Guard, origin: str | None, **headers: str) -> Any:
    """The first message of a socket, or the status of its refusal."""
    try:
        async with connect(
            f"ws://127.0.0.1:{guard.port}",
            origin=origin,
            additional_headers=headers,
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        ) as link:
            return await asyncio.wait_for(link.recv(), 10)
    except InvalidStatus as refused:
        return refused.response.status_code


def test_the_token_gives_the_cookie_and_the_cookie_the_page(guard: Guard) -> None:
    status, headers, body = get(guard, f"/?token={guard.token}")
    assert status == 200
    assert headers["set-cookie"] == guard.set_cookie
    assert b"url=/" in body
    assert guard.cookie.encode() not in body
    status, headers, body = get(guard, "/", Cookie=cookie(guard))
    assert status == 200
    assert len(body) > 10_000
    assert headers["x-frame-options"] == "DENY"


@pytest.mark.parametrize("packing", ["identity", "gzip, br"])
def test_until_it_is_connected_the_page_shows_no_tools_of_viser(guard: Guard, packing: str) -> None:
    known = {"Cookie": cookie(guard), "Accept-Encoding": packing}
    status, headers, body = get(guard, "/", **known)
    assert status == 200
    assert int(headers["content-length"]) == len(body)
    head = body.partition(b"</head>")[0]
    assert b"<title>Viser</title>" not in head
    assert b"<title>pcore studio</title>" in head
    assert b"html:not(.connected)" in head


def test_without_a_token_there_is_no_page(guard: Guard) -> None:
    for path in ("/", "/?token=wrong", "/index.html"):
        assert get(guard, path)[0] == 403
    strange = f'{guard.cookie_name}="\xff\xfe"'
    assert get(guard, "/", Cookie=strange)[0] == 403, "bytes that are no text are no failure"


def test_a_name_of_somebody_else_is_refused(guard: Guard) -> None:
    given = {"Host": f"evil.example:{guard.port}", "Cookie": cookie(guard)}
    assert get(guard, f"/?token={guard.token}", **given)[0] == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", None])
def test_a_socket_of_another_page_is_refused(guard: Guard, origin: str | None) -> None:
    assert asyncio.run(joined(guard, origin, Cookie=cookie(guard))) == 403


def test_a_socket_without_cookie_is_refused_and_one_with_it_is_served(guard: Guard) -> None:
    own = f"http://127.0.0.1:{guard.port}"
    assert asyncio.run(joined(guard, own)) == 403
    assert asyncio.run(joined(guard, own, Cookie=f"{guard.cookie_name}=wrong")) == 403
    assert isinstance(asyncio.run(joined(guard, own, Cookie=cookie(guard))), bytes)


@pytest.mark.parametrize(
    "path", ["/../server.py", "/%2e%2e/%2e%2e/server.py", "/..%5c..%5cserver.py", "//etc/passwd"]
)
def test_paths_lead_nowhere(guard: Guard, path: str) -> None:
    assert get(guard, path)[0] == 403
    assert get(guard, path, Cookie=cookie(guard))[0] == 404


def test_nobody_answers_for_tunnels_and_uploads(free_port: int) -> None:
    server = open_server(Guard(port=free_port), label="test")
    try:
        names = {kind.__name__ for kind in server._websock_server._incoming_handlers}
    finally:
        server.stop()
    assert "GuiUpdateMessage" in names
    assert not {name for name in names if "Share" in name or "FileTransfer" in name}


async def thrown_out(guard: Guard, *messages: bytes, wait: float = 2.0) -> int | None:
    """Why the server hung up after such messages; None where it did not."""
    async with connect(
        f"ws://127.0.0.1:{guard.port}",
        origin=f"http://127.0.0.1:{guard.port}",
        additional_headers={"Cookie": cookie(guard)},
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
    ) as link:
        try:
            for message in messages:
                await link.send(message)
            async with asyncio.timeout(wait):
                while True:
                    await link.recv()
        except ConnectionClosed as closed:
            return None if closed.rcvd is None else closed.rcvd.code
        except TimeoutError:
            return None


def test_a_message_too_large_ends_its_socket_alone(guard: Guard) -> None:
    assert asyncio.run(thrown_out(guard, b"x" * (LARGEST_MESSAGE + 1))) == 1009
    assert get(guard, "/", Cookie=cookie(guard))[0] == 200


def test_noise_ends_no_server(guard: Guard) -> None:
    noise = [random.Random(n).randbytes(3 * n) for n in range(40)]
    known = [b"\x81\xa4type\xaeShareUrlRequest", b"\x81\xa4type\xa5GuiXX"]
    for message in [*noise, *known]:
        asyncio.run(thrown_out(guard, message, wait=0.0))
    assert get(guard, "/", Cookie=cookie(guard))[0] == 200
    own = f"http://127.0.0.1:{guard.port}"
    assert isinstance(asyncio.run(joined(guard, own, Cookie=cookie(guard))), bytes)


def test_a_port_in_use_is_named_with_its_owner_and_the_next(guard: Guard) -> None:
    with pytest.raises(InputError, match=r"another pcore page uses; take --port \d+"):
        check_port("127.0.0.1", guard.port)


def test_an_address_that_is_not_asked_for_does_not_answer(guard: Guard) -> None:
    with pytest.raises(OSError):  # noqa: PT011
        socket.create_connection(("127.0.0.2", guard.port), timeout=2).close()


def test_what_is_printed_is_one_address(guard: Guard) -> None:
    assert guard.url == f"http://127.0.0.1:{guard.port}/?token={guard.token}"
