"""Who may talk to a page that this machine serves.

Any web page that the user has open may send requests to addresses of this machine. Such a request
says in `Origin` which page sent it, says in `Host` by which name it came here (a name of somebody
else, after DNS rebinding), and does not know the token that only the printed address has.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

LOOPBACK = "127.0.0.1"
_LOCAL = frozenset({"127.0.0.1", "localhost", "::1"})
_ANYWHERE = frozenset({"0.0.0.0", "::", ""})
LARGEST_MESSAGE = 1 << 20
"""Bytes of a message from a page; a drag is some hundred."""
_ONE = r"[^\s:;,'\"\\/](?:[^:;,'\"\n\\/]*[^\s:;,'\"\\/])?"
"""A folder, of which spaces may be a part but not an end."""
_PLACE = re.compile(rf"(?<![\w.])(?:[A-Za-z]:|~|\.\.?)?[\\/](?:{_ONE}[\\/])*([^\s:;,'\"\\/]+)")
_FILE = r"([\w-][\w. -]*\.[A-Za-z]\w{1,11})\b"
_BELOW = re.compile(
    rf"(?:(?:^|(?<=: )|(?<=['\"]))(?:{_ONE}[\\/])+|(?<![\w./\\-])(?!docs/)(?:[\w.-]+[\\/])+){_FILE}"
)
"""A file in a folder below, but a page of our docs.

What has no ending may be a place in an edit, as handles/0/to.
"""


@dataclass(frozen=True, kw_only=True)
class Guard:
    """What a request must bring along.

    Attributes:
        port: that the server listens at.
        host: name or address that it listens at; only this machine by default.
        token: in the address that is printed; what a browser shows once.
        cookie: what the browser gets for it, and shows from then on.
    """

    port: int
    host: str = LOOPBACK
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    cookie: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def url(self) -> str:
        """Address to print, with the token."""
        name = LOOPBACK if self.host in _ANYWHERE else self.host
        name = f"[{name}]" if ":" in name else name
        return f"http://{name}:{self.port}/?token={self.token}"

    @property
    def cookie_name(self) -> str:
        """Cookies do not know ports, so that their names must."""
        return f"pcore-{self.port}"

    @property
    def set_cookie(self) -> str:
        """Value of the header `Set-Cookie`; no script reads it, no other site sends it."""
        return f"{self.cookie_name}={self.cookie}; HttpOnly; SameSite=Strict; Path=/"

    def refusal(self, headers: Mapping[str, str], path: str, *, socket: bool) -> str | None:
        """Say why a request is refused; None where it is not.

        Args:
            headers: of the request, by names in lower case.
            path: with its query.
            socket: whether it asks for a WebSocket, for which the token does not count.
        """
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._is_ours(host):
            return "another host"
        if (socket or origin is not None) and origin != f"http://{host}":
            return "another origin"
        if self._has_cookie(headers.get("cookie", "")) or (not socket and self.brings_token(path)):
            return None
        return "no token"

    def brings_token(self, path: str) -> bool:
        """Whether the query of a path has the token."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        return _same(given, self.token)

    def _has_cookie(self, header: str) -> bool:
        try:
            found = SimpleCookie(header).get(self.cookie_name)
        except CookieError:
            return False
        given = "" if found is None else found.value
        return _same(given, self.cookie)

    def _is_ours(self, header: str) -> bool:
        """Whether a `Host` header means this server."""
        try:
            parts = urlsplit(f"//{header}")
            name, port = parts.hostname or "", parts.port
        except ValueError:
            return False
        if port != self.port or parts.username is not None:
            return False
        if name in _LOCAL or name == self.host.lower():
            return True
        # Nobody can make an address of numbers point elsewhere; a name anybody can.
        return self.host in _ANYWHERE and _is_address(name)


WELCOME = (
    b"<!DOCTYPE html><meta http-equiv=refresh content='0;url=/'>"
    b"<link rel=icon href=data:,><title>pcore</title>"
)
"""Answer to the token: the page asks for itself, so that the cookie counts as of the same site."""

HEADERS = (
    ("X-Content-Type-Options", "nosniff"),
    ("X-Frame-Options", "DENY"),
    ("Referrer-Policy", "no-referrer"),
    ("Cache-Control", "no-store"),
)
"""Of every answer."""
REFUSED = HTTPStatus.FORBIDDEN


def plain(text: str) -> str:
    """Return a message without the folders of this machine, of which only last names are kept."""
    return _BELOW.sub(r"\1", _PLACE.sub(r"\1", text))


def is_file_name(name: str) -> bool:
    """Whether a name from a page names a file of the one folder that it may write to."""
    return bool(re.fullmatch(r"[\w][\w. -]{0,99}", name, re.ASCII)) and ".." not in name


def _same(given: str, secret: str) -> bool:
    """Compare in constant time; bytes that are no text arrive as halves of letters."""
    return secrets.compare_digest(given.encode(errors="replace"), secret.encode())


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
