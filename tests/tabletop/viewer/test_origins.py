"""Only the viewer's own page connects: pages of other origins, and other names, are refused."""

import platform
from collections.abc import Iterator
from typing import Any

import pytest
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cgtorch.tabletop.viewer.origins import is_own, own_pages_only


def headers(host: str | None, *origins: str) -> Headers:
    found = Headers() if host is None else Headers(Host=host)
    for origin in origins:
        found["Origin"] = origin
    return found


@pytest.mark.parametrize(
    ("host", "origins", "own"),
    [
        ("127.0.0.1:80", (), True),
        ("127.0.0.1:80", ("http://127.0.0.1:80",), True),
        ("localhost:80", ("http://localhost:80",), True),
        ("[::1]:80", ("http://[::1]:80",), True),
        ("192.168.7.1:80", ("http://192.168.7.1:80",), True),
        ("Lab.example:80", ("https://Lab.example:80",), True),
        (f"{platform.node()}:80", (), True),
        ("127.0.0.1:80", ("http://evil.example",), False),
        ("127.0.0.1:80", ("http://127.0.0.1:81",), False),
        ("127.0.0.1:80", ("http://localhost:80",), False),
        ("127.0.0.1:80", ("null",), False),
        ("127.0.0.1:80", ("http://127.0.0.1:80", "http://evil.example"), False),
        ("evil.example:80", ("http://evil.example:80",), False),
        ("evil.example:80", (), False),
        ("127.0.0.1.evil.example", (), False),
        ("[", (), False),
        (None, (), False),
    ],
)
def test_a_page_is_the_viewers_own(host: str | None, origins: tuple[str, ...], own: bool) -> None:
    assert is_own(headers(host, *origins), "lab.example") == own


def test_two_names_of_a_server_are_none() -> None:
    twice = headers("127.0.0.1:80")
    twice["Host"] = "localhost"
    assert not is_own(twice, "127.0.0.1")


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    before = websockets.asyncio.server.serve
    with own_pages_only("127.0.0.1"):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    assert websockets.asyncio.server.serve is before
    yield server.get_port()
    server.stop()


@pytest.mark.parametrize("origin", [None, "http://127.0.0.1:{}", "http://evil.example", "null"])
def test_others_cannot_connect(port: int, origin: str | None) -> None:
    words: Any = {"subprotocols": [f"viser-v{viser.__version__}"]}
    address, mine = f"ws://127.0.0.1:{port}", None if origin is None else origin.format(port)
    if origin is None or "{}" in origin:
        with connect(address, origin=mine, **words) as connection:
            assert len(connection.recv(timeout=20)) > 0
    else:
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=mine, **words)
