"""What users import: it is there, it is light, and each docstring says what one has to know."""

import ast
import collections.abc
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from torch import Tensor

import cgtorch

PACKAGES = [m.name for m in pkgutil.iter_modules(cgtorch.__path__) if m.ispkg]
MODULES = ["ground.errors", "ground.counter_rng"]  # modules of their own that users import from
SHAPE = re.compile(r"\([A-Z0-9a-z_.,:·+*/ ×-]*(,|\))")  # such as (n, D), (B,) or (...)


def public() -> Iterator[tuple[str, Any]]:
    """Every function and class that a folder re-exports, or one of the modules has, once."""
    seen = set[int]()
    for package in [*PACKAGES, *MODULES]:
        module = importlib.import_module(f"cgtorch.{package}")
        for name, value in sorted(vars(module).items()):
            mine = package not in MODULES or getattr(value, "__module__", "") == module.__name__
            if name.startswith("_") or not callable(value) or id(value) in seen or not mine:
                continue
            if getattr(value, "__module__", "").startswith("cgtorch."):
                seen.add(id(value))
                yield f"{package}.{name}", value


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions, and the methods that public classes define."""
    for name, value in public():
        if inspect.isfunction(value):
            yield name, value
        elif inspect.isclass(value):
            for key, method in sorted(vars(value).items()):
                function = getattr(method, "__func__", method)
                plain = not key.startswith("_") or key == "__init__"
                if inspect.isfunction(function) and plain and function.__doc__:
                    yield f"{name}.{key}", function


EVERY = dict(public())
FUNCTIONS = dict(functions())


def parts(annotation: object) -> set[object]:
    """All types within one, but for what a function takes and gives."""
    called = typing.get_origin(annotation) is collections.abc.Callable
    inner = () if called else typing.get_args(annotation)
    return {annotation} if not inner else {t for i in inner for t in parts(i)}


def tensors(function: Callable[..., Any]) -> list[str]:
    """The arguments that are tensors, "return" too."""
    hints = inspect.get_annotations(function)
    return [name for name, hint in hints.items() if any(t is Tensor for t in parts(hint))]


def test_there_is_something_to_look_at() -> None:
    assert len(EVERY) > 100
    assert {"evolution.evolve", "evolution.tell", "graphs.Action"} <= set(EVERY)
    assert tensors(cgtorch.tell) == ["fitness", "scores"]


def shapeless(function: Callable[..., Any]) -> list[str]:
    """The tensors of whose shapes a docstring says nothing, neither under Args nor elsewhere."""
    text = inspect.getdoc(function) or ""
    if re.match(r"See `[\w.]+`", text):
        return []  # it is one of an interface, whose docstring says it
    _, _, listed = text.partition("Args:")
    described = dict(re.findall(r"^ +(\w+): ((?:.|\n(?!    \w+:|\n))*)", listed, re.MULTILINE))
    return [a for a in tensors(function) if not SHAPE.search(described.get(a, text))]


def test_everything_public_has_a_docstring() -> None:
    assert [name for name, value in EVERY.items() if not inspect.getdoc(value)] == []


def test_tensors_have_their_shapes_in_the_docstring() -> None:
    missing = {name: shapeless(function) for name, function in FUNCTIONS.items()}
    assert {name: some for name, some in missing.items() if some} == {}
    assert shapeless(without_shapes) == ["x"]


def without_shapes(x: Tensor, y: Tensor) -> None:
    """What would be found.

    Args:
        x: some numbers.
        y: (n,) others.
    """


def test_names_at_the_top_are_those_that_types_know() -> None:
    tree = ast.parse(Path(cgtorch.__file__).read_text())
    known = {
        alias.asname: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cgtorch.")
        for alias in node.names
    }
    assert {"__version__", *known} == set(cgtorch.__all__)
    assert set(known) <= set(dir(cgtorch))
    for name, module in known.items():
        assert getattr(cgtorch, name) is getattr(importlib.import_module(str(module)), name)
    with pytest.raises(AttributeError, match="has no attribute 'Fly'"):
        _ = cgtorch.Fly


def test_importing_the_library_does_not_import_torch() -> None:
    program = "import sys, cgtorch; assert cgtorch.__version__; print('torch' in sys.modules)"
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ended.stdout == "False\n"
