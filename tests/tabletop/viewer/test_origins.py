"""Only the viewer's own page connects: pages of other origins, and other names, are refused."""

from collections.abc import Iterator
from typing import Any

import pytest
import viser
import websockets.asyncio.server
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cgtorch.tabletop.viewer.origins import own_pages_only


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
