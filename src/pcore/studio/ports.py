"""Ports of this machine: whether one is free, and who has it."""

from __future__ import annotations

import socket
from contextlib import closing
from http.client import HTTPConnection, HTTPException

from pcore.errors import InputError

PORT = 8123
SERVER = "pcore"
"""How our servers call themselves in every answer."""
_TRIES = 50


def check_port(host: str, port: int) -> None:
    """Refuse a port that is taken, and say which is not.

    Raises:
        InputError: it is taken, not a port, or the host is not one of this machine.
    """
    if not 0 < port < 65536:
        raise InputError(f"--port: expected a number from 1 to 65535, got {port}")
    problem = _problem(host, port)
    if problem is None:
        return
    following = range(port + 1, min(port + _TRIES, 65536))
    free = next((one for one in following if _problem(host, one) is None), None)
    if free is None:
        raise InputError(f"--host {host} --port {port}: cannot listen there ({problem})")
    raise InputError(
        f"--port {port}: expected a free port, got one that {_owner(host, port)} uses; take "
        f"--port {free}"
    )


def family_of(host: str, port: int) -> socket.AddressFamily:
    """Whether a host is listened to by IPv4 or IPv6.

    Raises:
        OSError: there is no such host.
    """
    return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]


def _problem(host: str, port: int) -> str | None:
    """Why nobody can listen there; None where one can."""
    try:
        with closing(socket.socket(family_of(host, port), socket.SOCK_STREAM)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except OSError as error:
        return error.strerror or str(error)
    return None


def _owner(host: str, port: int) -> str:
    """Who listens there, as far as its answers tell."""
    with closing(HTTPConnection(host, port, timeout=1)) as connection:
        try:
            connection.request("GET", "/")
            name = connection.getresponse().getheader("Server", "")
        except (OSError, HTTPException):
            name = ""
    return "another pcore page" if name == SERVER else "another program"
