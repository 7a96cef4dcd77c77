"""What building a wheel adds to it: the C sources compiled, so that no compiler is needed later.

They are compiled for this CPU, or for all that wheels have libraries for if `CGTORCH_CPUS` is
`all`. Without a compiler, or on other machines than x86-64 with Linux, the wheel has the sources
only.
"""

import importlib.util
import os
import platform
import subprocess
import sysconfig
import time
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SUPPORTED = ("Linux", "x86_64")


class CompiledLibraries(BuildHookInterface[Any]):
    """Compiles the sources for some or all of `TARGETS` of cgtorch/native/compiler.py."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling; an editable install compiles nothing, as it has the sources."""
        if self.target_name != "wheel" or version == "editable":
            return
        compiler = _compiler_module(Path(self.root))
        name = compiler.found_compiler()
        if name is None or (platform.system(), platform.machine()) != SUPPORTED:
            self.app.display_warning("nothing is compiled: the wheel has the C sources only")
            return
        wish, own = os.environ.get("CGTORCH_CPUS", "own"), compiler.own_capability(name)
        if wish not in ("own", "all"):
            raise RuntimeError(f"CGTORCH_CPUS is {wish!r}: give own or all, or leave it out")
        targets = compiler.TARGETS if wish == "all" else own and [own]
        if not targets:
            self.app.display_warning("nothing is compiled yet: the first use does so for this CPU")
            return
        folder = Path(self.directory) / "compiled"
        folder.mkdir(parents=True, exist_ok=True)
        wanted = {
            folder / compiler.wheel_file_name(real, target): (real, compiler.TARGETS[target])
            for real, target in product(compiler.REALS, targets)
        }
        files = len(compiler.c_files())
        self.app.display_info(
            f"{name} compiles {len(wanted) * files} objects: {files} C files, for numbers of "
            f"{' and '.join(compiler.REALS)}, and CPUs with {' and '.join(targets)}; "
            f"this takes up to {len(wanted) * 25} s of two cores"
        )
        begun = time.monotonic()
        try:
            compiler.compile_libraries(name, wanted)
        except (OSError, subprocess.SubprocessError) as e:
            raise RuntimeError(f"{name} cannot compile the C sources: {e}") from e
        self.app.display_info(f"compiled in {time.monotonic() - begun:.0f} s")
        for path in wanted:
            build_data["force_include"][str(path)] = f"cgtorch/native/compiled/{path.name}"
        build_data["pure_python"] = False
        platform_tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"py3-none-{platform_tag}"


def _compiler_module(root: Path) -> ModuleType:
    """cgtorch/native/compiler.py without the rest of the package, which needs torch."""
    path = root / "cgtorch" / "native" / "compiler.py"
    spec = importlib.util.spec_from_file_location("cgtorch_native_compiler", path)
    if spec is None or spec.loader is None:
        raise RuntimeError(f"{path} is missing")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
