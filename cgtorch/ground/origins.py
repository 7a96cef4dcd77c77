"""Which pages may use a server of this machine: its own only.

A browser lets any page connect to a server on its machine, and tells the server by `Origin` which
page it is. By a name of their own for this machine (DNS rebinding), strangers would be of the same
origin, so that the name in `Host` has to be one of this machine, too.
"""

import ipaddress
import platform
from collections.abc import Sequence
from urllib.parse import urlsplit


def is_own(asked: Sequence[str], origins: Sequence[str], host: str) -> bool:
    """Whether a request calls this machine by its own name, and is of a page from there.

    Args:
        asked: The values of its header `Host`, of which there has to be one.
        origins: The values of its header `Origin`, if it has any.
        host: The name or address that the server was given.
    """
    if len(asked) != 1:
        return False
    try:
        name = urlsplit(f"//{asked[0]}").hostname or ""
        pages = [urlsplit(origin).netloc for origin in origins]
    except ValueError:
        return False
    known = name in {"localhost", host.lower(), platform.node().lower()} or _is_address(name)
    return known and all(page == asked[0] for page in pages)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
