"""The server of episodes: pages for its own browser page only, and made in one thread."""

import gc
import queue
import socket
import threading
import urllib.error
import urllib.request
import warnings
from collections.abc import Iterator
from concurrent.futures import Future

import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.report import episode_server
from cgtorch.report.episode_server import HEADERS, Waiting, answer_for_ever, serving


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
    assert headers["Content-Length"] == str(len(text))
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


@pytest.mark.parametrize(
    ("host", "port", "why"),
    [
        ("192.0.2.1", 0, "Cannot assign requested address"),
        ("192.0.2.1", 8000, "Cannot assign requested address"),
        ("no host", 0, "not known"),
        ("x" * 100, 0, "not known"),
        ("ä" * 100, 0, "encoding of hostname failed"),  # which is no error of the system
    ],
    ids=["elsewhere", "elsewhere-8000", "a name", "a long name", "no encoding"],
)
def test_why_a_host_cannot_be_listened_on(host: str, port: int, why: str) -> None:
    told = rf"^host '{host}' cannot be listened on \(.*{why}.*\); give 127\.0\.0\.1, or"
    with pytest.raises(SettingsError, match=told), serving(host, port):
        pass


def test_no_port_is_tried_beyond_the_last_one() -> None:
    with socket.socket() as last:
        last.bind(("127.0.0.1", 65535))
        last.listen()
        told = r"listened on \(Address already in use\); give"
        with pytest.raises(SettingsError, match=told), serving("127.0.0.1", 65535):
            pass


def test_nothing_is_left_of_a_server_that_has_ended() -> None:
    others = {*threading.enumerate()}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ResourceWarning)
        with serving("127.0.0.1", 0) as (address, _):
            (server,) = {*threading.enumerate()} - others
            assert server.daemon, "a program that ends does not wait for it"
            port = int(address.rpartition(":")[2])
        gc.collect()
    assert told == [], "as of a socket that nobody has closed"
    server.join(5)
    assert not server.is_alive()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), 5)


def test_a_connection_that_says_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episode_server, "PATIENCE", 0.1)
    with serving("127.0.0.1", 0) as (address, _):
        port = int(address.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), 5) as silent:
            assert silent.recv(1) == b""


def test_an_error_of_a_page_ends_the_answers_and_is_told_to_whoever_asked() -> None:
    waiting: Waiting = queue.SimpleQueue()
    first, second = Future[bytes](), Future[bytes]()
    waiting.put(({"skill": "unknown"}, first))
    waiting.put(({"skill": "known"}, second))
    pages = {"known": b"a page"}
    ended = list[BaseException]()

    def answering() -> None:
        try:
            answer_for_ever(waiting, lambda query: pages[query["skill"]])
        except KeyError as e:
            ended.append(e)

    answers = threading.Thread(target=answering, daemon=True)
    answers.start()
    error = first.exception(5)
    answers.join(5)
    assert ended == [error]
    assert not second.done()
