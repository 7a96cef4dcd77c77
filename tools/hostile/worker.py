"""The process that reads hostile files: it may crash, hang or run out of memory, and is replaced.

    python -m hostile.worker FORMAT SEED FIRST END FOLDER

It writes one line of JSON for each input, after one that says that it is ready. The input itself is
in its file before it is read, so that whoever waits finds it there when no line comes.
"""

import json
import os
import random
import resource
import sys
from pathlib import Path
from typing import Any

import torch

from cgtorch import native
from cgtorch.ground.errors import CgtorchError
from hostile.formats import FORMATS, prepare
from hostile.mutations import CANARY, damaged

MEMORY = 512 * 2**20  # bytes that reading a file may take, whatever it says
LONGEST = 1000  # characters of a message
_WRITING = {"os.mkdir", "os.rename", "os.remove", "os.link", "os.symlink", "os.truncate"}
_NEVER = {
    "subprocess.Popen", "os.system", "os.exec", "os.fork", "os.posix_spawn", "socket.connect",
    "pickle.find_class",
}  # fmt: skip


def said(call: Any, crimes: list[str]) -> tuple[str, str]:
    """Whether an input was accepted, refused or a failure, and what was said."""
    try:
        call()
    except CgtorchError as e:
        return wrong(str(e)) or ("refused", str(e)[:80])
    except BaseException as e:  # whatever it is, it is what is looked for
        return "failed", f"{type(e).__name__}: {e}"[:300]
    finally:
        if crimes:
            raise SystemExit(f"forbidden: {crimes[0]}")
    return "accepted", ""


def wrong(message: str) -> tuple[str, str] | None:
    """What is wrong with an error's message."""
    if not message or len(message) > LONGEST or not (message + "x").isprintable():
        return "failed", f"message of {len(message)} characters: {message[:200]!a}"
    return ("failed", f"tells a secret: {message[:200]}") if CANARY in message else None


def watched(folder: Path) -> list[str]:
    """From now on, what is written outside the folder, run, sent or unpickled is listed here."""
    crimes: list[str] = []
    inside = (str(folder.resolve()), "/dev/null")

    def hook(event: str, args: tuple[Any, ...]) -> None:
        writes = event in _WRITING or (
            event == "open" and bool((args[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        )
        if event in _NEVER or (
            writes
            and isinstance(args[0], str | bytes | os.PathLike)
            and not os.path.abspath(os.fsdecode(args[0])).startswith(inside)
        ):
            crimes.append(f"{event} {args[0]!r:.200}")

    sys.addaudithook(hook)
    return crimes


def main(name: str, seed: int, first: int, end: int, folder: Path) -> None:
    """Read the inputs from `first` up to `end`."""
    torch.set_num_threads(1)
    sys.dont_write_bytecode = True
    for dtype in (torch.float32, torch.float64):  # a file's numbers say which, the first compiles
        native.function("rbf_values", dtype)
    kind, run = FORMATS[name], folder / "run"
    actions = prepare(run)
    sources, path = kind.sources(run, actions), run / kind.file
    kind.load(run, actions) if path.is_file() else None  # imports what it needs
    path.parent.mkdir(parents=True, exist_ok=True)
    crimes = watched(folder)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    print("ready", flush=True)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for i in range(first, end):
        draw = random.Random(f"{seed} {name} {i}")  # noqa: S311  of inputs, not of secrets
        path.write_bytes(damaged(kind.mutation, draw.choice(sources), draw))
        verdict, text = said(lambda: kind.load(run, actions), crimes)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        print(json.dumps([i, verdict, text, grown]), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]), Path(sys.argv[5]))
