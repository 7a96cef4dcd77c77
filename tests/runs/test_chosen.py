"""What a path on a command line stands for: a skill, and the data of a run."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from support import create_run
from trained import SMALL, Trained, copied

from cgtorch.ground.errors import RunError
from cgtorch.runs.chosen import chosen_skill, folder_of_last, last_skill, stored_data
from cgtorch.runs.storage import ASIDE, DATA, load_dataset
from cgtorch.runs.stored_run import read_run


def test_a_run_stands_for_its_last_skill_and_a_stage_for_its_own(trained: Trained) -> None:
    folder = trained.folder
    for path, name, wanted in (
        (folder, None, "S1"),
        (folder, "S0", "S0"),
        (folder / "S0", None, "S0"),
        (folder / "S1", None, "S1"),
    ):
        chosen = chosen_skill(path, name, (), None)
        assert chosen.skill.name == wanted
        assert chosen.stage == folder / wanted
        assert chosen.kind == "perimeter"
        assert chosen.run is not None
        assert chosen.run.folder == folder
        assert chosen.domain is chosen.run.domain
    assert chosen_skill(folder, None, (), "near").kind == "near"
    alone = chosen_skill(folder / "S0" / "skill.json", None, (), None)
    assert (alone.skill.name, alone.run, alone.stage) == ("S0", None, None)


def test_a_stage_is_found_from_within_its_folder(
    trained: Trained, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(trained.folder / "S0")
    run, skill = last_skill(Path())
    assert (run.folder, skill.name) == (trained.folder, "S0")
    assert stored_data(Path())[1] == "S0"


def test_what_has_no_skill_is_told(trained: Trained, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"no skill 'S7' in run .*; give one of S0, S1"):
        chosen_skill(trained.folder, "S7", (), None)
    begun = create_run(tmp_path / "run", SMALL)
    with pytest.raises(RunError, match="give one of another run; this one has no skill yet"):
        chosen_skill(begun.folder, "S0", (), None)
    with pytest.raises(RunError, match="has no finished stage or round, and no skill of an int"):
        last_skill(begun.folder)
    with pytest.raises(RunError, match="is no run and no stage of one; give RUN or RUN/S2"):
        last_skill(tmp_path)
    assert folder_of_last(begun) is None
    for stage in ("S0", "S1"):  # an interrupted one, with its best skill so far
        place = begun.folder / "journal" / stage
        place.mkdir(parents=True)
        shutil.copy(trained.folder / stage / "skill.json", place)
        assert folder_of_last(begun) == place
        assert last_skill(begun.folder)[1].name == stage


def test_the_data_of_a_run_are_those_of_its_last_part_or_of_one_that_is_named(
    trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    for path, name, part in (
        (folder, None, "S1"),
        (folder, "S0", "S0"),
        (folder, "start", "start"),
        (folder / "S0", None, "S0"),
        (folder / "start", None, "start"),
    ):
        run, found, data = stored_data(path, name)
        assert (run.folder, found) == (folder, part)
        learned, aside = (load_dataset(folder / part / file) for file in (DATA, ASIDE))
        for key, value in vars(data).items():
            assert torch.equal(value, torch.cat([vars(learned)[key], vars(aside)[key]]))
    (folder / "S1" / DATA).unlink()
    with pytest.raises(RunError, match=r"S1' has no data: the run is stored without them"):
        stored_data(folder)
    with pytest.raises(RunError, match=r"has no part 'S2'; give one of start, S0, S1"):
        stored_data(folder, "S2")


def test_before_the_first_stage_data_are_those_of_the_start(
    trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run", ())
    assert stored_data(folder)[1] == "start"


def test_a_stage_after_one_that_is_missing_does_not_count(trained: Trained, tmp_path: Path) -> None:
    assert read_run(copied(trained, tmp_path / "both")).stages == ("S0", "S1")
    assert read_run(copied(trained, tmp_path / "first", ("S0",))).stages == ("S0",)
    assert read_run(copied(trained, tmp_path / "second", ("S1",))).stages == ()
    for name in ("auto-1", "auto-2", "auto-4"):
        folder = shutil.copytree(trained.folder / "S0", tmp_path / "both" / name)
        skill = json.loads((folder / "skill.json").read_text())
        (folder / "skill.json").write_text(json.dumps({**skill, "name": name}))
        for part in folder.glob("*.safetensors"):  # which say that they are of S0
            part.unlink()
    assert read_run(tmp_path / "both").stages == ("S0", "S1", "auto-1", "auto-2")
    assert read_run(tmp_path / "both").rounds == ("auto-1", "auto-2")
