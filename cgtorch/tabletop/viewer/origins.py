"""Which pages may connect to the viewer: its own only."""

import http
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from cgtorch.ground.origins import is_own

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
            asked, origins = map(request.headers.get_all, ("Host", "Origin"))
            if not is_own(asked, origins, host):
                said = b"open the viewer itself, by an address or by the name that --host has\n"
                return Response(http.HTTPStatus.FORBIDDEN, "FORBIDDEN", Headers(), said)
            return process_request(connection, request) if process_request else None

        return serve(*given, process_request=answer, **how)

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
