"""A C compiler that does not optimise, for tests of what is compiled when, and of where it goes."""

from pathlib import Path

from cgtorch.native import compiler


def quick_compiler(folder: Path) -> str:
    """The path of the compiler, a script in `folder`. It takes a fraction of the usual time."""
    path = folder / "quick-cc"
    path.write_text(
        f'#!/bin/sh\nexec "{compiler.found_compiler()}" "$@" -O0 -Dalways_inline=unused\n'
    )
    path.chmod(0o700)
    return str(path)
