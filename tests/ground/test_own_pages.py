"""Which requests are of a server's own page."""

import platform

import pytest

from cgtorch.ground.origins import is_own


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
    assert is_own([] if host is None else [host], origins, "lab.example") == own


def test_two_names_of_a_server_are_none() -> None:
    assert not is_own(["127.0.0.1:80", "localhost"], (), "127.0.0.1")
