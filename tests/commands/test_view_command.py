"""`cgtorch-view`: bad input. What it shows is tried in `tests/browser` and `tests/tabletop`."""

import re
import signal
import subprocess
import sys
import urllib.request

import pytest
from command_line import REFERENCE, VIEW, Shell


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none"], "'none' is no run and no stage of one; give RUN or RUN/S2"),
        ([REFERENCE, "--skill", "S9"], "no skill 'S9' in run"),
        ([REFERENCE, "--against", "none"], "'none' is no run and no stage of one"),
        ([REFERENCE, "--scenarios", "moon"], "unknown placement 'moon'; use one of near,"),
        ([REFERENCE, "--scenarios", "general-clutter"], "reads percepts of 7 numbers, those of"),
        ([REFERENCE, "--host", "192.0.2.1"], "host '192.0.2.1' cannot be listened on"),
        ([REFERENCE, "--host", "no host"], "host 'no host' cannot be listened on"),
        ([REFERENCE, "--host", "x" * 100], "cannot be listened on"),
        ([REFERENCE, "--port", "65536"], "65536 is not in the range 0<=x<=65535"),
        ([REFERENCE, "--count", "0"], "0 is not in the range 1<=x<=10000"),
        ([REFERENCE, "--seed", "-1"], "-1 is not in the range"),
        ([REFERENCE, "--world", "moon"], "world is 'moon'; use one of kin"),
        ([REFERENCE, "--film", "skill.mp4"], "give a name that ends in .gif or"),
    ],
)
def test_bad_input(shell: Shell, words: list[str], message: str) -> None:
    assert message in shell.refuses(VIEW, *words)


def test_without_viser_it_says_what_to_install(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What Python itself does with a package that cannot be imported.
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'cgtorch[view]'" in shell.refuses(VIEW, REFERENCE)


def test_it_serves_on_loopback_until_it_is_told_to_end() -> None:
    words = [sys.executable, "-u", "-m", "cgtorch.commands.view", str(REFERENCE), "--port", "0"]
    pipe = subprocess.PIPE
    # Where the tests run in the background of a script, Ctrl-C would be ignored.
    with subprocess.Popen(
        words, stdout=pipe, stderr=pipe, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as view:  # fmt: skip
        assert view.stdout is not None
        assert view.stderr is not None
        line = view.stdout.readline()
        found = re.fullmatch(r"S3 at work: (http://127\.0\.0\.1:\d+) \(Ctrl-C ends it\)\n", line)
        assert found is not None, line + view.stderr.read()
        with urllib.request.urlopen(found[1]) as answer:  # noqa: S310
            assert answer.status == 200
            assert b"<html" in answer.read()
        view.send_signal(signal.SIGINT)
        assert view.wait(60) == 0
        assert view.stderr.read() == ""
