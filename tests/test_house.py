"""Which folders and files know of which, how much there is to know, and names of tests."""

import ast
from collections.abc import Iterator
from pathlib import Path

import networkx as nx
import pytest

import cgtorch
from cgtorch import Domain

PACKAGE = Path(cgtorch.__file__).parent
TABLETOP = "cgtorch.tabletop"
NAMING = {Path("__init__.py"), Path("domains", "registry.py")}
"""Files that may name the tabletop, as text or for type checkers, but do not import it."""


def files_outside(*folders: str) -> list[Path]:
    """The package's files, but for those in some of its folders."""
    every = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))
    return [path for path in every if path.parts[0] not in folders]


def parsed(path: Path) -> ast.Module:
    return ast.parse((PACKAGE / path).read_text(encoding="utf-8"))


def imported(tree: ast.AST, package: str) -> Iterator[str]:
    """Modules, or names in them, that a file of a package imports anywhere, also in functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            where = [*(above if node.level else []), *([node.module] if node.module else [])]
            yield from (".".join([*where, alias.name]) for alias in node.names)


def named(tree: ast.AST) -> Iterator[str]:
    """Texts that could be given to something that imports, so not those that only explain."""
    explaining = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        if text and id(node) not in explaining:
            yield node.value


def without_typing(tree: ast.Module) -> ast.Module:
    """The file without what stands under `if TYPE_CHECKING`."""

    class Typing(ast.NodeTransformer):
        def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
            self.generic_visit(node)
            checked = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
            return node.orelse if checked else node

    return Typing().visit(tree)


def package_of(path: Path) -> str:
    return ".".join([PACKAGE.name, *path.parent.parts])


def is_tabletop(name: str) -> bool:
    return name == TABLETOP or name.startswith((f"{TABLETOP}.", f"{TABLETOP}:"))


@pytest.mark.parametrize("path", files_outside("tabletop", "commands"), ids=str)
def test_nothing_but_commands_imports_the_tabletop(path: Path) -> None:
    tree = without_typing(parsed(path)) if path in NAMING else parsed(path)
    assert not [name for name in imported(tree, package_of(path)) if is_tabletop(name)]
    if path not in NAMING:
        assert not [text for text in named(tree) if is_tabletop(text)]


def test_the_files_that_name_the_tabletop_do() -> None:
    """Else they are no exception any more."""
    texts = {path: [*named(parsed(path)), *imported(parsed(path), "cgtorch")] for path in NAMING}
    assert all(any(map(is_tabletop, found)) for found in texts.values())


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import cgtorch.tabletop.world", True),
        ("from cgtorch import tabletop", True),
        ("from cgtorch.tabletop import world", True),
        ("from ..tabletop import world", True),
        ("from .. import tabletop", True),
        ("def f():\n    from cgtorch.tabletop.world import Scenarios", True),
        ("if TYPE_CHECKING:\n    import cgtorch.tabletop", True),
        ("from . import tabletop", False),
        ("from cgtorch.tabletops import world", False),
        ("import tabletop", False),
    ],
)
def test_any_way_to_import_is_seen(code: str, found: bool) -> None:
    assert any(map(is_tabletop, imported(ast.parse(code), "cgtorch.domains"))) is found


def test_what_type_checkers_read_can_be_left_out() -> None:
    code = "if TYPE_CHECKING:\n    import cgtorch.tabletop\nelse:\n    import cgtorch.svm"
    assert [*imported(without_typing(ast.parse(code)), "cgtorch")] == ["cgtorch.svm"]


def test_texts_that_only_explain_are_no_names() -> None:
    code = '"""cgtorch.tabletop"""\nwhere = "cgtorch.tabletop:Tabletop"\n'
    assert [text for text in named(ast.parse(code)) if is_tabletop(text)] == [
        "cgtorch.tabletop:Tabletop"
    ]


def test_no_two_test_files_share_a_name() -> None:
    """pytest imports a test file by its bare name, so it refuses the second of two."""
    names = [path.name for path in Path(__file__).parent.rglob("test_*.py")]
    assert {name for name in names if names.count(name) > 1} == set()


def modules() -> dict[str, Path]:
    """The package's files by the names of their modules."""
    paths = files_outside()
    return {
        package_of(p) if p.stem == "__init__" else f"{package_of(p)}.{p.stem}": p for p in paths
    }


def home_of(name: str, known: dict[str, Path]) -> str:
    """The module in which an imported name is; "" outside the package."""
    while name and name not in known:
        name = name.rpartition(".")[0]
    return name


def arrows() -> nx.DiGraph:
    """From each module to those that it imports anywhere, also for type checkers only."""
    known = modules()
    found = nx.DiGraph()
    for module, path in known.items():
        homes = {home_of(name, known) for name in imported(parsed(path), package_of(path))}
        found.add_edges_from((module, home) for home in homes - {module, ""})
    # What a folder's `__init__` exports is looked up late, and is where it is defined.
    found.remove_nodes_from([m for m, p in known.items() if p.stem == "__init__"])
    return found


def circles(graph: nx.DiGraph) -> list[set[str]]:
    return [found for found in nx.strongly_connected_components(graph) if len(found) > 1]


def test_no_modules_and_no_folders_import_each_other() -> None:
    modules_ = arrows()
    assert modules_.number_of_edges() > 500
    assert circles(modules_) == []
    rooms = nx.DiGraph((a.split(".")[1], b.split(".")[1]) for a, b in modules_.edges)
    rooms.remove_edges_from([*nx.selfloop_edges(rooms)])
    assert circles(rooms) == []


def test_a_domain_has_few_members() -> None:
    own = {*vars(Domain), *Domain.__annotations__, "settings"}
    assert len([name for name in own if not name.startswith("_")]) <= 16


def test_a_folder_and_a_file_can_be_known() -> None:
    sources = [p for p in PACKAGE.rglob("*") if p.suffix in {".py", ".c", ".h", ".cu"}]
    assert len({p.relative_to(PACKAGE).parts[0] for p in sources if p.parent != PACKAGE}) <= 15
    assert [str(p) for p in sources if len(p.read_text().splitlines()) > 350] == []
