"""Mutants: what changes, which tests are closest, and what becomes of a package with weak tests."""

import ast
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mutants.c_edits import c_edits
from mutants.c_functions import POOL, callers, exported, made_of
from mutants.closest import closest
from mutants.drawn import drawn, rooms
from mutants.python_edits import python_edits
from mutants.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
PYTHON = '''
MOST = 7
def f(x: int = 3, *, dim: int = 0) -> bool:
    """Text 5."""
    if x < 2 and not any(x):  # < in a comment
        raise ValueError(f"{x + 1}")
    for y in zip(x, strict=True):
        x.y += max(y, key=1, default=-z)
        continue
    return x is not None
'''
C = """
typedef struct { int a[3]; } A;
/* a < b */
static int f(const A *a, int n) {
  int most = 0;
  const int *room[4][2], other[3];
  for (int i = 0; i < n; i++) {
    if (!a->a[i] && n >= 2) continue;
    most += a->a[i] * 1.5;
    g(most, "n < 3");
  }
  return -most;
}
"""
TRAINED = """
import os
from made_once import made_once, shared_folder

def trained_run(tmp_path_factory):
    return made_once(shared_folder(tmp_path_factory) / "trained", make_run)

def make_run(path):
    path.write_text("trained")
    os.makedirs(os.environ["XDG_CACHE_HOME"], exist_ok=True)
    with open(os.path.join(os.environ["XDG_CACHE_HOME"], "trained"), "a") as file:
        file.write("once\\n")
"""


def test_what_changes_in_python() -> None:
    source = PYTHON.encode()
    edits = python_edits(source)
    found = {edit.shown(source)[1] for edit in edits}
    assert found == {
        "def f(x: int = 3, *, dim: int = 1) -> bool:",
        *(f"if {each}:  # < in a comment".replace("  ", " ") for each in (
            "x <= 2 and not any(x)", "x > 2 and not any(x)", "x < 3 and not any(x)",
            "x < 2 or not any(x)", "x < 2 and any(x)", "x < 2 and not all(x)",
        )),
        "pass",
        "x.y -= max(y, key=1, default=-z)",
        "x.y += min(y, key=1, default=-z)",
        "x.y += max(y, default=-z)",
        "x.y += max(y, key=0, default=-z)",
        "x.y += max(y, key=1)",
        "x.y += max(y, key=1, default=z)",
        "break",
        "return x is None",
        "return (not (x is not None))",
    }  # fmt: skip
    for edit in edits:
        ast.parse(edit.applied(source))
    assert {edit.line(source) for edit in edits} == {3, 5, 6, 8, 9, 10}


def test_what_changes_in_c() -> None:
    source = C.encode()
    found = {edit.shown(source)[1] for edit in c_edits(source)}
    assert found == {
        "int most = 1;",
        "for (int i = 1; i < n; i++) {",
        "for (int i = 0; i <= n; i++) {",
        "for (int i = 0; i > n; i++) {",
        "for (int i = 0; i < n; i--) {",
        "if (a->a[i] && n >= 2) continue;",
        "if (!a->a[i] || n >= 2) continue;",
        "if (!a->a[i] && n > 2) continue;",
        "if (!a->a[i] && n < 2) continue;",
        "if (!a->a[i] && n >= 3) continue;",
        "if (!a->a[i] && n >= 2) break;",
        "most -= a->a[i] * 1.5;",
        "most += a->a[i] / 1.5;",
        "most += a->a[i] * 3.0;",
        ";",
        "return most;",
    }


@pytest.mark.parametrize("room", ["graphs", "native"])
def test_a_seed_draws_its_lines_each_once(room: str) -> None:
    assert room in rooms(ROOT / "cgtorch")
    first, again, other = (list(drawn(ROOT, room, seed)) for seed in (1, 1, 2))
    assert first == again
    places = [(mutant.file, mutant.line) for mutant in first]
    assert len(set(places)) == len(places)
    assert places != [(mutant.file, mutant.line) for mutant in other]
    assert set(places) == {(mutant.file, mutant.line) for mutant in other}
    for mutant in first[:20]:
        assert (ROOT / mutant.file).read_bytes() != mutant.edit.applied(
            (ROOT / mutant.file).read_bytes()
        )


def test_who_runs_the_line_comes_first_and_the_time_is_limited() -> None:
    file = "cgtorch/svm/platt.py"
    known = {
        "tests/svm/test_rbf.py": [
            Recording("slow", 2.0, {file: [7, 8]}),
            Recording("quick", 0.5, {file: [8]}),
            Recording("near", 0.1, {file: [9]}),
            Recording("far", 0.1, {"cgtorch/svm/rbf.py": [8]}),
        ]
    }

    def names(line: int, budget: float) -> list[str]:
        found = closest(ROOT, file, line, lambda path: known.get(path, []), budget)
        return [recording.test for recording in found]

    assert names(8, 9) == ["quick", "slow", "near"]
    assert names(7, 9) == ["slow", "near", "quick"]
    assert names(8, 1) == ["quick", "near"]
    assert names(7, 1) == ["slow"]  # one runs in any case


def test_a_c_file_is_run_by_who_calls_what_is_compiled_with_it() -> None:
    for file in ("rbf.c", "rbf.h"):
        functions = made_of(ROOT, f"cgtorch/native/svm/{file}")
        path, line = functions["rbf_values"]
        assert (ROOT / path).read_text().splitlines()[line - 1].startswith("int rbf_values(")
        assert "smo_problems" not in functions
        assert ("kernel_rollouts" in functions) == (file == "rbf.h")
        assert ("tests/native/test_angles.py" in functions) == (file == "rbf.h")
    assert callers(ROOT, ["rbf_values"]) == {"cgtorch/svm/rbf.py"}
    # Their names are put together.
    assert callers(ROOT, ["tabletop_rollouts"]) == {"cgtorch/simulation/compiled.py"}
    assert callers(ROOT, ["worlds_resumed"]) == {"cgtorch/simulation/resumable.py"}
    assert made_of(ROOT, POOL).keys() >= exported(ROOT).keys()


def test_tests_of_a_c_file_are_those_that_call_it_and_compile_no_kernels() -> None:
    file = "cgtorch/native/engine/selection.c"
    functions, asked = made_of(ROOT, file), []

    def recorded(path: str) -> list[Recording]:
        asked.append(path)
        ranked = [functions["ranking"][1]] if path.endswith("test_selection.py") else []
        return [Recording(f"{path}::test", 0.1, {file: ranked} if ranked else {})]

    (found,) = closest(ROOT, file, 1, recorded, 9)
    assert found.test == "tests/evolution/test_selection.py::test"
    assert "tests/evolution/test_operators.py" in asked
    assert "tests/evolution/test_gpu_operators.py" not in asked
    closest(ROOT, "cgtorch/native/svm/rbf.c", 1, recorded, 9)
    assert "tests/svm/test_rbf.py" in asked
    assert "tests/svm/test_storage.py" not in asked  # as one has the module's own name


def test_a_package_with_a_weak_test(tmp_path: Path) -> None:
    """One function is tested, one is not, and the third never ends if it is changed."""
    texts = {
        "cgtorch/__init__.py": "",
        "cgtorch/room/__init__.py": "",
        "cgtorch/room/tested.py": "def more(x):\n    return x + 1\n",
        "cgtorch/room/weak.py": "def less(x):\n    return x - 1\n",
        "cgtorch/room/known.py": "def half(x):\n    return x / 2\n",
        "cgtorch/room/read.py": "def read(path):\n    return len(path.read_text()) + 1\n",
        "tests/conftest.py": "",
        "tests/trained.py": TRAINED,
        "tests/room/test_them.py": (
            "from cgtorch.room.tested import more\nfrom cgtorch.room.weak import less\n\n"
            "def test_more():\n    assert more(2) == 3\n\ndef test_less():\n    less(2)\n"
        ),
        "tests/room/test_read.py": (
            "from cgtorch.room.read import read\nfrom trained import trained_run\n\n"
            "def test_read(tmp_path_factory):\n"
            "    assert read(trained_run(tmp_path_factory)) == 8\n"
        ),
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    tools = ROOT / "tools"
    shutil.copytree(tools / "mutants", tmp_path / "tools" / "mutants")
    shutil.copy(tools / "mutate.py", tmp_path / "tools")
    shutil.copy(ROOT / "tests" / "made_once.py", tmp_path / "tests")
    about = {"file": "cgtorch/room/known.py", "old": "return x / 2"}
    known = [{**about, "new": new, "why": "a test"} for new in ("return x * 2", "return x / 3")]
    (tmp_path / "tools" / "mutants" / "equivalent.json").write_text(json.dumps(known))
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)  # noqa: S607
    output = tmp_path / "output.json"
    done = subprocess.run(
        [sys.executable, "tools/mutate.py", "--room", "room", "--output", str(output)],
        cwd=tmp_path, check=True, capture_output=True, text=True,
        env={"PATH": "/usr/bin:/bin", "XDG_CACHE_HOME": str(tmp_path / "cache")},
    ).stdout  # fmt: skip
    assert done.splitlines()[-1].split() == ["room", "3", "2", "1", "67", "%"]
    assert "SURVIVED 1 tests, last tests/room/test_them.py::test_less" in done
    (tally,) = json.loads(output.read_text())
    by = {trial["mutant"]["file"][13:]: trial for trial in tally["trials"]}
    assert by["tested.py"]["killed"]
    assert by["tested.py"]["by"] == "tests/room/test_them.py::test_more"
    assert not by["weak.py"]["killed"]
    assert by["read.py"]["by"] == "tests/room/test_read.py::test_read"
    assert (tmp_path / "cache" / "trained").read_text() == "once\n"
    assert {name: (tmp_path / name).read_text() for name in texts} == texts
