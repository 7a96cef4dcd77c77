"""The server of episodes: pages for its own browser page only, and made in one thread."""

import threading
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.report.episode_server import HEADERS, answer_for_ever, serving


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serving("127.0.0.1", 0) as (address, waiting):
        made = threading.Thread(
            target=answer_for_ever,
            args=(waiting, lambda query: f"{query} in {threading.current_thread().name}".encode()),
            name="maker",
            daemon=True,
        )
        made.start()
        yield address


def asked(address: str, place: str = "/", **headers: str) -> tuple[int, str, dict[str, str]]:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        wanted = urllib.request.Request(address + place, headers=named)  # noqa: S310
        with urllib.request.urlopen(wanted) as got:  # noqa: S310
            return got.status, got.read().decode(), dict(got.headers)
    except urllib.error.HTTPError as e:
        return e.code, e.read().decode(), dict(e.headers)


def test_a_query_is_answered_in_the_thread_that_makes_pages(address: str) -> None:
    status, text, headers = asked(address, "/?skill=2&number=3&skill=4")
    assert (status, text) == (200, "{'skill': '4', 'number': '3'} in maker")
    assert HEADERS.items() <= headers.items()
    assert asked(address, "/elsewhere")[0] == 404


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Sec_Fetch_Site": "same-origin", "Sec_Fetch_Mode": "no-cors"}, 200),
        ({"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"}, 200),
        ({"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"}, 403),
        ({"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.example"}, 403),
    ],
)
def test_pages_of_other_origins_get_nothing(
    address: str, headers: dict[str, str], status: int
) -> None:
    found, text, _ = asked(address, **headers)
    assert found == status
    assert ("open the viewer itself" in text) == (status == 403)


def test_a_port_that_is_taken_and_a_host_that_is_not_here() -> None:
    with serving("127.0.0.1", 0) as (first, _):
        port = int(first.rpartition(":")[2])
        with serving("127.0.0.1", port) as (second, _):
            assert port < int(second.rpartition(":")[2]) <= port + 20
    for host in ("192.0.2.1", "no host", "x" * 100):
        with pytest.raises(SettingsError, match="cannot be listened on"), serving(host, 0):
            pass
