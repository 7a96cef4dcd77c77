"""A server of pages on which skills act, for this machine's browser only."""

import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from errno import EADDRINUSE
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeAlias
from urllib.parse import parse_qsl, urlsplit

from cgtorch.ground.errors import SettingsError
from cgtorch.ground.origins import is_own

TRIES = 20  # ports after the one that is wished for
PATIENCE = 30.0  # s that a connection may say nothing
HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}

Pages: TypeAlias = Callable[[dict[str, str]], bytes]
"""Makes the page that a query asks for."""

Waiting: TypeAlias = "queue.SimpleQueue[tuple[dict[str, str], Future[bytes]]]"


@contextmanager
def serving(host: str, port: int) -> Iterator[tuple[str, Waiting]]:
    """A server's address, and the queries that wait to be answered (`answer_for_ever`).

    SettingsError if this machine cannot listen there. If the port is taken, it is the next free
    one.
    """
    waiting: Waiting = queue.SimpleQueue()
    server = _listening(host, port, _handler(host, waiting))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://{host}:{server.server_address[1]}", waiting
    finally:
        server.shutdown()
        server.server_close()


def answer_for_ever(waiting: Waiting, pages: Pages) -> None:
    """Make pages in this thread, one after the other, as graphics libraries want it."""
    while True:
        query, answer = waiting.get()
        try:
            answer.set_result(pages(query))
        except BaseException as e:
            answer.set_exception(e)
            raise


def _listening(host: str, port: int, handler: type[BaseHTTPRequestHandler]) -> ThreadingHTTPServer:
    """A server at the port, or at the next one that is free."""
    for number in [0] if port == 0 else range(port, min(port + TRIES, 65536)):
        try:
            return ThreadingHTTPServer((host, number), handler)
        except (OSError, TypeError) as e:  # the latter of a name in no encoding
            error = e
            if getattr(e, "errno", None) != EADDRINUSE:
                break
    raise SettingsError(
        f"host {host!r} cannot be listened on ({getattr(error, 'strerror', None) or error}); give "
        "127.0.0.1, or an address of this machine"
    ) from error


def _handler(host: str, waiting: Waiting) -> type[BaseHTTPRequestHandler]:
    """Handles the requests of one server: a page for its own origin, nothing for others."""

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE

        def do_GET(self) -> None:
            asked, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
            inside = self.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin")
            opened = self.headers.get("Sec-Fetch-Mode") == "navigate"
            if not is_own(asked, origins, host) or not (inside or opened):
                said = b"open the viewer itself, by an address or by the name that --host has\n"
                self._send(HTTPStatus.FORBIDDEN, said)
                return
            place = urlsplit(self.path)
            if place.path != "/":
                self._send(HTTPStatus.NOT_FOUND, b"nothing is here\n")
                return
            answer: Future[bytes] = Future()
            waiting.put((dict(parse_qsl(place.query)), answer))
            if answer.exception() is None:  # else the viewer has ended
                self._send(HTTPStatus.OK, answer.result())

        def _send(self, status: HTTPStatus, page: bytes) -> None:
            with suppress(OSError):  # of a browser that has left
                self.send_response(status)
                for name, value in {**HEADERS, "Content-Length": str(len(page))}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(page)

        def log_message(self, *about: Any) -> None:
            """Say nothing of requests."""

    return Handler
