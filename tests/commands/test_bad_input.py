"""Bad input: one line that says what and what to do, exit code 2, nothing half-written."""

import json
import os
import re
import resource
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import EVALUATE, TRAIN, Shell, as_options, edited, in_a_shell, listing
from trained import SMALL, Trained, copied

from cgtorch.tabletop.kinematics import robots_folder

PR2 = robots_folder() / "pr2"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--stage", "S4"], "unknown stage 'S4'; use one of S0, S1, S2, S3"),
        (["--stage", ""], "unknown stage ''"),
        (["--stage", "../S0"], "unknown stage '../S0'"),
        (["--actions", "Fly"], "unknown action 'Fly'; known are"),
        (["--actions", "no_such_package:Fly"], "cannot import action 'no_such_package:Fly'"),
        (["--actions", "json:loads"], "give a subclass of Action"),
        (["--actions", ":"], "action ':'"),
        (["--seed", "-1"], "seed is -1; give a whole number of at least 0"),
        (["--seed", "one"], "'one' is not a valid integer; see cgtorch-train --help"),
        (["--seed", "99999999999999999999"], "seed is 99999999999999999999"),
        (["--population", "1"], "population is 1; give a whole number of at least 2"),
        (["--generations", "0"], "generations is 0"),
        (["--attempts", "0"], "attempts is 0"),
        (["--transitions", "5"], "transitions is 5"),
        (["--method", "magic"], "method is 'magic'; use one of compose, paper"),
        (["--position-noise", "nan"], "position_noise is nan"),
        (
            ["--stage", "auto", "--target", "1"],
            "target is 1, which is no share of scenarios",
        ),
        (["--stage", "auto", "--target", "nan"], "target is nan"),
        (["--domain", "gymnasium:CartPole-v1", "--target", "1e400"], "target is inf; give a num"),
        (["--processes", "9" * 30], "'--processes': 9999"),
        (["--checkpoint-seconds", "nan"], "'--checkpoint-seconds': nan is no number"),
        (["--stage", "auto", "--minutes", "-1"], "minutes is -1.0; give a number from 0 to"),
        (["--stage", "auto", "--rounds", "0"], "rounds is 0; give a whole number of at least 1"),
        (["--target", "0.9"], "target, minutes and rounds are for stage 'auto' (--stage auto);"),
        (["--stage", "S1", "--rounds", "3"], "rounds are for stage 'auto' (--stage auto); ask"),
        (
            ["--scenarios", "general"],
            "use perimeter scenarios, not general; use stage 'auto'",
        ),
        (["--stage", "S0", "--scenarios", "general-clutter"], "use stage 'auto'"),
        (["--scenarios", "near"], "stages S0 to S3 use perimeter scenarios, not near; use stage"),
        (["--percept", "nose"], "percept is 'nose'; use one of auto, box, yaw"),
        (["--stage", "auto-1"], "unknown stage 'auto-1'; use one of S0, S1, S2, S3, auto"),
        (["--device", "abacus"], "device 'abacus' cannot be used; give auto, cpu or cuda"),
        (["--device", "cuda:99"], "device 'cuda:99' cannot be used"),
        (["--device", "meta"], "device 'meta' cannot be used"),
        (["--colour", "red"], "--colour"),
        (["more"], "unexpected extra argument (more); see cgtorch-train --help"),
        (["--urdf", "none.urdf"], "none.urdf"),
        (["--robot", "none.json"], "none.json"),
        (["--robot", "fetsch"], "none of the built-in robots (fetch, pr2): give one"),
        (["--resume", "none"], "'none' is no run (it has no run.json); give the folder of a run"),
        (["--run-dir", ""], "a run cannot replace the current folder; choose another"),
        (["--run-dir", "."], "a run cannot replace the current folder; choose another"),
    ],
)
def test_training_with_bad_arguments(
    shell: Shell, tmp_path: Path, words: list[str], message: str
) -> None:
    assert message in shell.refuses(TRAIN, *words)
    assert listing(tmp_path) == set()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "Missing argument 'RUN_OR_SKILL'; see cgtorch-evaluate --help"),
        (["none"], "'none' is no run and no stage of one"),
        (["run", "--count", "0"], "--count': 0 is not in the range"),
        (["run", "--count", "many"], "'many' is not a valid integer"),
        (["run", "--seed", "-1"], "--seed': -1 is not in the range"),
        (["run", "--scenarios", "top"], "unknown scenarios 'top'; use one of perimeter, near"),
        (["run", "--actions", "Fly"], "was begun without action 'Fly' and cannot use it"),
        (["run", "--skill", "S7"], "no skill 'S7' in run 'run'; give one of S0"),
        (["run", "--skill", "../S0"], "no skill '../S0' in run"),
        (["run/S0", "--skill", "S0"], "'run/S0' is no run but a part of the run"),
        (["run/S1"], "'run/S1' is no run and no stage of one"),
        (["run/start"], "'run/start' is no run and no stage of one"),
        (["run/run.json"], "not a skill file"),
        (["run/S0/data.safetensors"], "not proper JSON"),
        (["/dev/null"], "'/dev/null' is no run"),
        (["run", "more"], "unexpected extra argument"),
    ],
)
def test_evaluating_with_bad_arguments(
    shell: Shell, trained: Trained, tmp_path: Path, words: list[str], message: str
) -> None:
    before = listing(copied(trained, tmp_path / "run", ("S0",)))
    assert message in shell.refuses(EVALUATE, *words)
    assert listing(tmp_path / "run") == before


@pytest.mark.parametrize(
    ("urdf", "words", "message"),
    [
        ("<robot", {}, "XML"),
        ("", {}, "XML"),
        ("<robot/>", {}, "root links"),
        (None, {"torso_joint": "neck_joint"}, "'neck_joint'"),
    ],
)
def test_a_broken_robot(
    shell: Shell, tmp_path: Path, urdf: str | None, words: dict[str, str], message: str
) -> None:
    """Of what is no URDF, or with a joint that the URDF lacks."""
    about_robot = json.loads((PR2 / "robot.json").read_text())
    text = (PR2 / "pr2.urdf").read_text() if urdf is None else urdf
    (tmp_path / "my.urdf").write_text(text)
    (tmp_path / "my.json").write_text(json.dumps(about_robot | words))
    assert message in shell.refuses(TRAIN, "--urdf", "my.urdf", "--robot", "my.json")
    assert listing(tmp_path) == {"my.urdf", "my.json"}


@pytest.mark.parametrize("place", ["a_file", "a_file/run", "/proc/run", "full", "/dev/null"])
def test_a_run_folder_that_cannot_be_written(shell: Shell, tmp_path: Path, place: str) -> None:
    (tmp_path / "a_file").write_text("text")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("text")
    before = listing(tmp_path)
    message = shell.refuses(TRAIN, "--run-dir", place)
    assert "choose another" in message or "check the folder" in message
    assert listing(tmp_path) == before


def test_a_name_that_no_file_can_have(shell: Shell, tmp_path: Path) -> None:
    name = "x" * 300
    for words in ((TRAIN, "--run-dir", name), (TRAIN, "--resume", name), (EVALUATE, name)):
        assert "File name too long" in shell.refuses(*words)
    assert listing(tmp_path) == set()


@pytest.fixture
def run_folder(trained: Trained, tmp_path: Path) -> Path:
    """A run up to S0, to be spoilt."""
    return copied(trained, tmp_path / "run", ("S0",))


def skill_file(folder: Path, change: str) -> Path:
    data = json.loads((folder / "S0" / "skill.json").read_text())
    while data["skills"] and not data["edges"]:
        data = next(iter(data["skills"].values()))
    if change == "edge":
        del data["edges"][0]
    else:
        node = next(n for n in data["nodes"] if n["parameters"])
        node["parameters"][0] = float("nan")
    path = folder.parent / "skill.json"
    path.write_text(json.dumps(data))
    return path


def test_a_folder_that_is_a_loop_of_links(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    said = shell.refuses(TRAIN, "--domain", "gymnasium:CartPole-v1", "--run-dir", tmp_path / "loop")
    assert "loop" in said


def test_a_skill_file_with_a_missing_edge(shell: Shell, run_folder: Path) -> None:
    path = skill_file(run_folder, "edge")
    assert "has no edge for outcome" in shell.refuses(EVALUATE, path)
    shutil.copy(path, run_folder / "S0" / "skill.json")
    assert "has no edge for outcome" in shell.refuses(EVALUATE, run_folder)
    before = listing(run_folder)
    assert "has no edge for outcome" in shell.refuses(TRAIN, "--resume", run_folder, "--quiet")
    assert {name for name in listing(run_folder) - before if "tfevents" not in name} == set()


def test_a_skill_file_with_parameters_that_are_no_numbers(shell: Shell, run_folder: Path) -> None:
    path = skill_file(run_folder, "nan")
    assert "number NaN is not finite" in shell.refuses(EVALUATE, path)
    path.write_text(path.read_text().replace("NaN", "1e999"))
    assert "number 1e999 is not finite" in shell.refuses(EVALUATE, path)
    path.write_text(path.read_text().replace("1e999", "1e39"))
    assert "has parameter 1e+39; give finite" in shell.refuses(EVALUATE, path)


def test_a_run_of_another_version(shell: Shell, run_folder: Path) -> None:
    before = listing(run_folder)
    for version in (1, 5, 7, 0, "6", None, [6]):
        edited(run_folder, version=version)
        for words in (
            (TRAIN, "--resume", run_folder),
            (TRAIN, "--run-dir", run_folder),
            (EVALUATE, run_folder),
            (EVALUATE, run_folder / "S0"),
            ("cgtorch-report", run_folder, "--output", run_folder.parent / "page.html"),
            ("cgtorch-export", run_folder, "--format", "dot", "--output", run_folder.parent / "x"),
            ("cgtorch-view", run_folder),
        ):
            message = shell.refuses(*words)
            said = f"is of version {version!r}, this cgtorch reads 6; use the version that wrote it"
            assert said in message
    edited(run_folder, version=6, format="other")
    assert "is not of a cgtorch run" in shell.refuses(EVALUATE, run_folder)
    assert listing(run_folder) == before


def test_a_run_with_an_unknown_setting_or_without_a_skill(
    shell: Shell, trained: Trained, run_folder: Path, tmp_path: Path
) -> None:
    edited(run_folder, {"colour": "red"})
    said = shell.refuses(EVALUATE, run_folder)
    assert f"in '{run_folder / 'run.json'}', setting 'colour' is unknown or missing" in said
    empty = copied(trained, tmp_path / "empty", ())
    said = f"no skill of an interrupted one; finish one with cgtorch-train --resume {empty}"
    assert said in shell.refuses(EVALUATE, empty)


def test_settings_that_differ_from_the_runs(shell: Shell, run_folder: Path) -> None:
    before = listing(run_folder)
    message = shell.refuses(TRAIN, "--run-dir", run_folder, "--seed", 3)
    assert (
        f"has seed {SMALL.seed}, not 3, and cannot change it, as everything in the run was drawn"
        in message
    )
    assert "choose another run folder" in message
    assert "has its robot already" in shell.refuses(
        TRAIN, "--run-dir", run_folder, *as_options(SMALL), "--urdf", PR2 / "pr2.urdf"
    )
    message = shell.refuses(TRAIN, "--resume", run_folder, "--run-dir", "x")
    assert "--run-dir cannot change in a run that has begun; leave it out" in message
    message = shell.refuses(TRAIN, "--resume", run_folder, "--urdf", "x")
    assert "has urdf , not x, and cannot change it, as the run has its robot already" in message
    assert message.endswith("; leave it out\n")
    message = shell.refuses(TRAIN, "--resume", run_folder, "--seed", SMALL.seed, "--population", 80)
    assert "has population 60, not 80; leave it out, or take it over with" in message
    assert f"--resume {run_folder} --override population=80" in message
    assert listing(run_folder) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["seed=3"],
            f"seed {SMALL.seed} of run .* cannot become 3, as everything in the run",
        ),
        (["--transitions=300"], "transitions 200 of run .* as the first models were learned"),
        (["position-noise=0.1"], "position_noise 0.005 of run .* as W was solved under it"),
        (
            ["percept=yaw"],
            "percept auto of run .* as the data and models of the run depend on it",
        ),
        (["method=paper"], "neither method can continue the other's skills"),
        (["population=80", "seed=3"], f"seed {SMALL.seed} of run"),
        (["population"], "--override 'population' names no setting; give NAME=VALUE"),
        (["colour=red"], "--override 'colour=red' names no setting"),
        (["actions=x:Y"], "actions .* as the graphs of the run contain them"),
        (["population=many"], "'many' is not a valid integer"),
        (["population=0"], "population is 0; give a whole number of at least 2"),
        (["tournament="], "'' is not a valid integer"),
    ],
)
def test_what_cannot_be_taken_over(
    words: list[str], message: str, shell: Shell, run_folder: Path
) -> None:
    about = (run_folder / "run.json").read_bytes()
    parts = [part for word in words for part in ("--override", word)]
    assert re.search(message, shell.refuses(TRAIN, "--resume", run_folder, *parts))
    assert (run_folder / "run.json").read_bytes() == about


def test_overrides_are_for_runs_that_have_begun(shell: Shell, run_folder: Path) -> None:
    words = ["--run-dir", run_folder, "--override", "population=80"]
    message = shell.refuses(TRAIN, *words)
    assert "--override is for a run that has begun; add --resume RUN" in message


MODULE = """
import pathlib
pathlib.Path("imported").write_text("yes")
from cgtorch.tabletop.actions import Detect
class Look(Detect): pass
"""


def test_code_that_a_file_names_is_not_imported(
    shell: Shell, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "foreign_code.py").write_text(MODULE)
    edited(run_folder, {"actions": ["foreign_code:Look"]})
    monkeypatch.syspath_prepend(tmp_path)
    for words in (
        (TRAIN, "--resume", run_folder),
        (EVALUATE, run_folder),
        (EVALUATE, run_folder / "S0"),
    ):
        message = shell.refuses(*words)
        assert (
            "which is code of its own; if you trust it, give it among the actions "
            "(--actions foreign_code:Look)" in message
        )
        assert not (tmp_path / "imported").exists()
    # A skill that names an action so cannot load code either.
    path = tmp_path / "skill.json"
    path.write_text(
        (run_folder / "S0" / "skill.json").read_text().replace("Grasp", "foreign_code:Look")
    )
    message = shell.refuses(EVALUATE, path)
    assert "unknown action 'foreign_code:Look'; known are MoveBase, Detect, " in message
    assert "; name your own domain or action with --domain or --actions package.module" in message
    assert not (tmp_path / "imported").exists()
    shell.does(EVALUATE, run_folder, "--actions", "foreign_code:Look", "--count", 1)
    assert (tmp_path / "imported").exists()


def test_names_in_files_lead_nowhere(shell: Shell, run_folder: Path, tmp_path: Path) -> None:
    """Names in a skill file are labels: they are never used as paths."""
    (tmp_path / "secret").write_text("text")
    path = run_folder / "S0" / "skill.json"
    before = listing(tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"name": "../../../secret"}))
    shell.does(EVALUATE, path, "--count", 1)
    assert "S0/skill.json' holds skill '../../../secret'" in shell.refuses(EVALUATE, run_folder)
    assert listing(tmp_path) == before
    assert (tmp_path / "secret").read_text() == "text"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 2 MiB, or nothing where it cannot be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = os.system(f"mount -t tmpfs -o size=2m none {place} 2>/dev/null") == 0  # noqa: S605
    if not mounted:
        pytest.skip("needs the right to mount")
    yield place
    os.system(f"umount {place}")  # noqa: S605


def fill(disk: Path, leave: int) -> None:
    """Write a file that leaves only so many bytes free."""
    free = shutil.disk_usage(disk).free
    (disk / "ballast").write_bytes(b"0" * (free - leave))


def test_a_full_disk(shell: Shell, small_disk: Path) -> None:
    fill(small_disk, leave=20_000)
    message = shell.refuses(TRAIN, "--run-dir", small_disk / "run")
    assert "No space left on device" in message
    assert listing(small_disk) == {"ballast"}


@pytest.mark.hostile
def test_a_disk_that_fills_up_while_a_run_goes_on(small_disk: Path, trained: Trained) -> None:
    folder = copied(trained, small_disk / "run", ("S0",))
    before = listing(folder)
    fill(small_disk, leave=0)
    ended = in_a_shell(TRAIN, "--resume", str(folder), "--stage", "S1", "--quiet")
    assert (ended.code, ended.err.count("\n")) == (2, 1), ended
    assert "No space left on device" in ended.err
    assert {name for name in listing(folder) - before if "tfevents" not in name} == set()
    assert (folder / "S0" / "skill.json").is_file()


def no_large_files() -> None:
    """Files end at 4 KiB from now on, as on a disk that is full."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.hostile
def test_files_that_may_not_grow(tmp_path: Path) -> None:
    ended = in_a_shell(TRAIN, "--run-dir", str(tmp_path / "run"), before=no_large_files)
    assert (ended.code, ended.err.count("\n")) == (2, 1), ended
    assert "File too large" in ended.err
    assert listing(tmp_path) == set()
