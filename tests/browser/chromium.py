"""Pages in Debian's headless Chromium, and servers that show them.

A test asks for the fixture `chromium` of `conftest.py` and opens a page with `visit`, which keeps
everything that went wrong on it: console errors, exceptions, requests to other machines.
"""

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from playwright.sync_api import Browser, ConsoleMessage, Error, Page, Request

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # WebGL without a graphics card, for scenes in three dimensions.
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--webgl-antialiasing-mode=none",
)
HERE = {"127.0.0.1", "localhost"}
WAIT_MS = 120_000  # on a busy machine


@dataclass
class Visit:
    """An open page and what went wrong on it so far."""

    page: Page
    errors: list[str] = field(default_factory=list)

    def heard(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.errors.append(f"console: {message.text} ({message.location})")

    def failed(self, error: Error) -> None:
        self.errors.append(f"exception: {error}")

    def asked(self, request: Request) -> None:
        url = urlsplit(request.url)
        if url.scheme in ("http", "https", "ws", "wss") and url.hostname not in HERE:
            self.errors.append(f"request to another machine: {request.url}")


@contextmanager
def visit(browser: Browser, url: str, width: int = 1280, height: int = 800) -> Iterator[Visit]:
    """Open a page in a fresh profile."""
    context = browser.new_context(viewport={"width": width, "height": height})
    context.set_default_timeout(WAIT_MS)
    try:
        opened = Visit(context.new_page())
        opened.page.on("console", opened.heard)
        opened.page.on("pageerror", opened.failed)
        opened.page.on("request", opened.asked)
        opened.page.goto(url)
        yield opened
    finally:
        context.close()


@contextmanager
def served(*words: str, seconds: float = 120) -> Iterator[str]:
    """Run `python -m words` until it prints the address it serves, and stop it at the end."""
    server = subprocess.Popen(
        [sys.executable, "-m", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert server.stdout is not None
    limit = threading.Timer(seconds, server.kill)
    limit.start()
    printed: list[str] = []
    try:
        for line in server.stdout:
            printed.append(line)
            if found := re.search(r"http://127\.0\.0\.1:\d+/?", line):
                limit.cancel()
                # What it prints from here on is read, so that it never waits for a reader.
                threading.Thread(target=printed.extend, args=(server.stdout,), daemon=True).start()
                yield found[0]
                return
        raise AssertionError(f"{' '.join(words)} served nothing:\n{''.join(printed)}")
    finally:
        limit.cancel()
        server.terminate()
        server.wait(30)
