"""What commands write replaces nothing unasked, and never what they read."""

from pathlib import Path

import pytest
from command_line import EVALUATE, EXPORT, REFERENCE, REPORT, VIEW, Shell

from cgtorch.ground.errors import RunError
from cgtorch.ground.replacing import WHY, check_output, check_outputs


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with names as in a run."""
    made = tmp_path / "run"
    names = ("run.json", "auto-1/skill.json", "events.out.tfevents.1.vm.2.0", "report.html")
    for name in names:
        (made / name).parent.mkdir(parents=True, exist_ok=True)
        (made / name).write_text("precious")
    return made


@pytest.mark.parametrize("part", ["", "auto-1"])
@pytest.mark.parametrize("name", ["run.json", "auto-1/skill.json", "events.out.tfevents.1.vm.2.0"])
def test_a_file_of_the_run_that_is_read_stays(run: Path, part: str, name: str) -> None:
    (run.parent / "link").symlink_to(run)
    for output in (run / name, run.parent / "link" / name):
        with pytest.raises(RunError, match=r"is a part of the run .*; choose another --output"):
            check_output(output, True, run / part)


def test_other_files_are_replaced_when_asked(run: Path) -> None:
    for read in (run, run / "auto-1"):
        check_output(run / "report.html", True, read)
        check_output(run / "auto-1" / "new.json", False, read)
        with pytest.raises(RunError, match=r"exists; choose another --film or add --force"):
            check_output(run / "report.html", False, read, "--film")


def test_a_file_of_any_run_stays(run: Path, tmp_path: Path) -> None:
    for read in (tmp_path / "other", tmp_path / "skill.json"):
        with pytest.raises(RunError, match=r"skill.json' is a part of the run .*/run'; choose"):
            check_output(run / "auto-1" / "skill.json", True, read)
    (run / "run.json").write_text('{"format": "somebody else\'s"}')
    check_output(run / "auto-1" / "skill.json", True, tmp_path / "other")


@pytest.mark.parametrize("name", ["failures.md", "failures.json", "kind-3.webp"])
def test_failures_replace_no_file_unasked(shell: Shell, run: Path, name: str) -> None:
    for folder in (run, run / "auto-1"):
        (folder / name).write_text("precious")
        said = shell.refuses(EVALUATE, REFERENCE, "--failures", folder)
        assert f"{name}' exists; choose another --failures or add --force" in said
        assert (folder / name).read_text() == "precious"
        check_outputs(folder, WHY, True, REFERENCE, "--failures")


def test_a_skill_file_is_not_replaced_by_what_is_made_of_it(run: Path) -> None:
    skill = run.parent / "skill.json"
    skill.write_text("precious")
    check_output(run.parent / "run" / "report.html", True, skill)
    with pytest.raises(RunError, match="is a part of"):
        check_output(skill, True, skill)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ((EVALUATE, REFERENCE, "--picture", "old.gif"), "--picture"),
        ((VIEW, REFERENCE, "--film", "old.gif"), "--film"),
    ],
)
def test_pictures_and_films_replace_no_file_unasked(
    shell: Shell, tmp_path: Path, words: tuple[object, ...], option: str
) -> None:
    (tmp_path / "old.gif").write_text("precious")
    said = f"'old.gif' exists; choose another {option} or add --force"
    assert said in shell.refuses(*words)
    assert (tmp_path / "old.gif").read_text() == "precious"


def test_a_picture_is_a_png(shell: Shell) -> None:
    said = shell.refuses(EVALUATE, REFERENCE, "--picture", "new.jpg")
    assert "--picture is 'new.jpg', and a PNG file is written; give a name that ends" in said


def test_what_is_read_is_not_replaced_by_force(shell: Shell) -> None:
    skill = REFERENCE / "S3" / "skill.json"
    for words in ((EXPORT, REFERENCE, "--format", "mermaid"), (REPORT, REFERENCE)):
        assert "is a part of the run" in shell.refuses(*words, "--output", skill, "--force")
