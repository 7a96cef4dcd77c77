"""A C compiler that does not optimise, for tests of what is compiled when, and of where it goes."""

from pathlib import Path

from cgtorch.native import compiler


def quick_compiler(folder: Path, empty: str = "-DREAL=none") -> str:
    """The path of the compiler, a script in `folder`. It takes a fraction of the usual time.

    It keeps the objects that it has made there, and copies them when it is called again for the
    same. With an option `empty` it makes empty objects.
    """
    path, cc = folder / "quick-cc", compiler.found_compiler()
    path.write_text(
        f'#!/bin/sh\nfor last; do :; done\ncase "$*" in *{empty}*" -c "*)\n'
        f'  exec "{cc}" -x c -c /dev/null -o "$last";;\n*" -c "*)\n'
        f'  kept="{folder}/$(echo "${{*%"$last"}}" | cksum | tr " " -).o"\n'
        f'  [ -e "$kept" ] || "{cc}" "$@" -O0 -Dalways_inline=unused || exit\n'
        '  [ -e "$kept" ] && exec cp "$kept" "$last"\n  exec cp "$last" "$kept";;\nesac\n'
        f'exec "{cc}" "$@" -O0 -Dalways_inline=unused\n'
    )
    path.chmod(0o700)
    return str(path)
