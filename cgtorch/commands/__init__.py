"""The command line."""

import os
import signal
import sys
from types import FrameType

_name = os.path.basename(sys.argv[0]) if sys.argv else ""


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, f"{_name}: interrupted\n".encode())
    os._exit(1)


# Until a command itself hears interrupts, it imports, where one would end in a traceback.
if _name.startswith("cgtorch") and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end)
