import pytest

from pcore.studio.guard import Guard, is_file_name, plain

OURS = "127.0.0.1:8123"


@pytest.fixture
def guard() -> Guard:
    return Guard(port=8123)


def headers(guard: Guard, **changes: str) -> dict[str, str]:
    """Of a page that shows its cookie; None takes a header out."""
    given = {
        "host": OURS,
        "origin": f"http://{OURS}",
        "cookie": f"{guard.cookie_name}={guard.cookie}",
    }
    return {name: value for name, value in (given | changes).items() if value}


def test_a_page_with_the_cookie_is_let_in(guard: Guard) -> None:
    assert guard.refusal(headers(guard), "/", socket=True) is None
    assert guard.refusal(headers(guard, origin=""), "/", socket=False) is None


@pytest.mark.parametrize(
    "host",
    ["evil.example:8123", "evil.example", "127.0.0.1", "127.0.0.1:80", "a@127.0.0.1:8123", "", "["],
)
def test_another_host_is_refused(guard: Guard, host: str) -> None:
    given = headers(guard, host=host, origin=f"http://{host}")
    assert guard.refusal(given, f"/?token={guard.token}", socket=False) == "another host"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", f"https://{OURS}", ""])
def test_a_socket_of_another_origin_is_refused(guard: Guard, origin: str) -> None:
    assert guard.refusal(headers(guard, origin=origin), "/", socket=True) == "another origin"


@pytest.mark.parametrize(
    "cookie",
    [
        *("", "pcore-8123=", "pcore-8123=wrong", "a=b; ;;=", "\x00"),
        b'pcore-8123="\xff\xfe"'.decode("ascii", "surrogateescape"),
    ],
)
def test_without_the_cookie_it_is_refused(guard: Guard, cookie: str) -> None:
    assert guard.refusal(headers(guard, cookie=cookie), "/", socket=True) == "no token"


def test_the_token_opens_the_page_and_no_socket(guard: Guard) -> None:
    path, bare = f"/?token={guard.token}", headers(guard, cookie="", origin="")
    assert guard.refusal(bare, path, socket=False) is None
    assert guard.refusal(bare, "/?token=", socket=False) == "no token"
    assert guard.refusal(headers(guard, cookie=""), path, socket=True) == "no token"


def test_the_cookie_is_not_the_token_and_no_script_reads_it(guard: Guard) -> None:
    assert guard.cookie not in guard.url
    assert guard.token not in guard.set_cookie
    assert {"HttpOnly", "SameSite=Strict"} <= set(guard.set_cookie.split("; "))
    assert guard.token not in repr(guard)
    assert guard.cookie not in repr(guard)


def test_listening_everywhere_takes_addresses_and_no_names() -> None:
    guard = Guard(port=8123, host="0.0.0.0")
    for host, refused in (("192.168.0.7:8123", None), ("evil.example:8123", "another host")):
        given = headers(guard, host=host, origin=f"http://{host}")
        assert guard.refusal(given, "/", socket=True) == refused


def test_messages_show_no_folders() -> None:
    text = "/home/anna/runs/toy/edit.json: expected JSON, got C:\\Users\\anna\\x.bin; see docs/a.md"
    assert plain(text) == "edit.json: expected JSON, got x.bin; see docs/a.md"
    assert plain("1/2 of 3 points at 0.5/s") == "1/2 of 3 points at 0.5/s"


def test_names_of_files_stay_in_their_folder() -> None:
    for good in ("edit.json", "pose 2.json", "a-b_c.png"):
        assert is_file_name(good)
    for bad in ("", ".", "..", "../edit.json", "a/b", "a\\b", ".hidden", "a..b", "x\0", "a" * 200):
        assert not is_file_name(bad)
