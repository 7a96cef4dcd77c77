"""Which pages may connect to the viewer: its own only.

A browser lets any page connect to a server on its machine, and tells the server by `Origin` which
page it is. By a name of their own for this machine (DNS rebinding), strangers would be of the same
origin, so that the name in `Host` has to be one of this machine, too.
"""

import http
import ipaddress
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

Answer = Callable[[Any, Request], Response | None]
"""Answers a request, or lets it open a connection by None."""


@contextmanager
def own_pages_only(host: str) -> Iterator[None]:
    """A context in which websockets make servers that refuse pages of other origins.

    viser has no way to say it. `host` is the name that the server is given.
    """
    serve: Any = websockets.asyncio.server.serve

    def guarded(*given: Any, process_request: Answer | None = None, **how: Any) -> Any:
        def answer(connection: Any, request: Request) -> Response | None:
            if not is_own(request.headers, host):
                said = b"open the viewer itself, by an address or by the name that --host has\n"
                return Response(http.HTTPStatus.FORBIDDEN, "FORBIDDEN", Headers(), said)
            return process_request(connection, request) if process_request else None

        return serve(*given, process_request=answer, **how)

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def is_own(headers: Headers, host: str) -> bool:
    """Whether a request calls this machine by its own name, and is of a page from there."""
    try:
        asked, origins = headers["Host"], headers.get_all("Origin")
        name = urlsplit(f"//{asked}").hostname or ""
        pages = [urlsplit(origin).netloc for origin in origins]
    except (KeyError, ValueError, LookupError):
        return False
    known = name in {"localhost", host.lower(), platform.node().lower()} or _is_address(name)
    return known and all(page == asked for page in pages)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
