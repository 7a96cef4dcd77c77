"""Parts of two runs that were mixed, and a domain that has changed, are refused at reading."""

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from trained import SMALL, Trained, copied

from cgtorch.graphs import load_skill
from cgtorch.ground.errors import ActionError, DomainError, RunError
from cgtorch.ground.fields import Field
from cgtorch.ground.files import head_notes
from cgtorch.runs.belonging import check_parts
from cgtorch.runs.chosen import lone_skill
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import load_dataset, load_scenarios, save_tensors
from cgtorch.runs.stored_run import planned_run, read_run, write_run
from examples.cart import Cart, Rail


def test_stages_that_changed_places_are_refused(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    for old, new in (("S0", "t"), ("S1", "S0"), ("t", "S1")):
        (run / old).rename(run / new)
    with pytest.raises(RunError, match=r"/S0/skill.json' holds skill 'S1', not 'S0': its folder"):
        read_run(run)
    (run / "S1").rename(run / "mine")  # what is no stage is the user's
    (run / "S0").rename(run / "S1")
    assert read_run(run).stages == ()


def test_one_skill_file_of_another_stage_is_refused(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    shutil.copy(run / "S0" / "skill.json", run / "S1" / "skill.json")
    with pytest.raises(RunError, match=r"/S1/skill.json' holds skill 'S0', not 'S1'.*; restore it"):
        read_run(run)
    assert lone_skill(run / "S1" / "skill.json")[2].name == "S0"


def test_a_round_may_hold_the_skill_of_an_earlier_one(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    for name in ("auto-1", "auto-2"):
        shutil.copytree(run / "S1", run / name)
    check = partial(check_parts, run, ("S0", "S1"), ("auto-1", "auto-2"), SMALL.seed)
    check()
    shutil.copy(run / "S1" / "skill.json", run / "S0" / "skill.json")
    with pytest.raises(RunError, match=r"/S0/skill.json' holds skill 'S1', not 'S0'"):
        check()


@pytest.mark.parametrize("part", ["data", "aside", "seen", "specialists"])
def test_parts_of_another_stage_are_refused(trained: Trained, tmp_path: Path, part: str) -> None:
    run = copied(trained, tmp_path / "run")
    shutil.copy(run / "S0" / f"{part}.safetensors", run / "S1" / f"{part}.safetensors")
    with pytest.raises(RunError, match=rf"S1/{part}.safetensors' was written with skill S0, not"):
        read_run(run)


@pytest.mark.parametrize("part", ["gamma", "classifier"])
def test_a_model_of_another_fit_is_refused(trained: Trained, tmp_path: Path, part: str) -> None:
    run = copied(trained, tmp_path / "run")
    for stage, other in (("S1", "start"), ("start", "S1")):
        ours, theirs = (run / name / f"{part}.safetensors" for name in (stage, other))
        before, another = ours.read_bytes(), theirs.read_bytes()
        ours.write_bytes(another)
        if another == before:
            read_run(run)
            continue
        with pytest.raises(RunError, match=rf"{part}.safetensors' is not the model that was lear"):
            read_run(run)
        ours.write_bytes(before)


def test_scenarios_of_another_stage_are_refused(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    shutil.copy(run / "S0" / "scenarios.json", run / "S1" / "scenarios.json")
    like = read_run(run).like()
    load_scenarios(run / "S0" / "scenarios.json", like)
    with pytest.raises(RunError, match=r"scenarios, and seen.safetensors beside it the percepts o"):
        load_scenarios(run / "S1" / "scenarios.json", like)


@pytest.mark.parametrize("file", ["start/data", "S0/aside", "S1/seen"])
def test_files_of_another_seed_are_refused(trained: Trained, tmp_path: Path, file: str) -> None:
    run = copied(trained, tmp_path / "run")
    path = run / f"{file}.safetensors"
    assert head_notes(path)["seed"] == str(SMALL.seed)
    save_tensors(path, {"percepts": torch.zeros(1, 2)}, {"seed": "99"})
    with pytest.raises(RunError, match=rf"{file}.safetensors' was made with seed 99, and run.json"):
        read_run(run)
    save_tensors(path, {"percepts": torch.zeros(1, 2)}, {})  # as older versions wrote it
    assert read_run(run).stages == ("S0", "S1")


def test_a_seed_that_was_edited_is_refused(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    about = json.loads((run / "run.json").read_text())
    about["settings"]["seed"] = SMALL.seed + 1
    (run / "run.json").write_text(json.dumps(about))
    said = f"was made with seed {SMALL.seed}, and run.json says {SMALL.seed + 1}: one of them"
    with pytest.raises(RunError, match=said):
        read_run(run)


@pytest.mark.parametrize("content", [b"", b"\xff" * 40, b"\x05" + bytes(7) + b"[[[[[" + bytes(9)])
def test_files_without_notes_are_left_to_their_readers(
    trained: Trained, tmp_path: Path, content: bytes
) -> None:
    run = copied(trained, tmp_path / "run")
    for file in ("S0/skill.json", "S1/data.safetensors"):
        (run / file).write_bytes(content)
    assert head_notes(run / "S1" / "data.safetensors") == head_notes(run) == {}
    read_run(run)


def test_a_run_may_be_moved(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run").rename(tmp_path / "another name")
    assert read_run(run).stages == ("S0", "S1")


PLACE, WIND, PUSH = Field("place", "m"), Field("wind", "m"), Field("push", "m", -1, 1)


class SlopeRail(Rail):
    """Perceives a third number."""

    def first_state(self, scenario: torch.Tensor) -> torch.Tensor:
        """See `World.first_state`."""
        return torch.nn.functional.pad(super().first_state(scenario), (0, 1))

    def next_state(
        self, state: torch.Tensor, control: torch.Tensor, scenario: torch.Tensor
    ) -> torch.Tensor:
        """See `World.next_state`."""
        return torch.nn.functional.pad(super().next_state(state[:, :2], control, scenario), (0, 1))


def changed(**parts: Any) -> Cart:
    """The cart after somebody has changed its class."""
    made = Cart()
    vars(made).update(parts)
    return made


@pytest.fixture
def cart_run(tmp_path: Path) -> Path:
    write_run(
        planned_run(tmp_path / "run", RunSettings(domain="examples.cart:Cart"), domain=Cart())
    )
    return tmp_path / "run"


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"percept": (WIND, PLACE)}, "percept wind, place by now, and run .* with place, wind;"),
        ({"percept": (PLACE, Field("gust"))}, "percept place, gust by now, .* with place, wind;"),
        ({"control": (Field("pull", "m", -1, 1),)}, "control pull by now, .* made with push;"),
    ],
)
def test_a_domain_with_other_numbers_is_refused(
    cart_run: Path, parts: dict[str, Any], said: str
) -> None:
    about = json.loads((cart_run / "run.json").read_text())
    assert (about["percept"], about["control"]) == (["place", "wind"], ["push"])
    read_run(cart_run, domain=Cart())
    with pytest.raises(DomainError, match=f"Cart has {said} bring that back, or train another"):
        read_run(cart_run, domain=changed(**parts))
    for name in ("percept", "control"):  # as older versions wrote it
        del about[name]
    (cart_run / "run.json").write_text(json.dumps(about))
    read_run(cart_run, domain=changed(**parts))


def test_a_domain_that_perceives_more_is_refused(cart_run: Path) -> None:
    more = {"percept": (PLACE, WIND, Field("slope")), "world": SlopeRail}
    with pytest.raises(DomainError, match="Cart has percept place, wind, slope by now"):
        read_run(cart_run, domain=changed(**more))


def test_what_is_in_the_place_of_a_run_is_told(trained: Trained, tmp_path: Path) -> None:
    run = copied(trained, tmp_path / "run")
    settings = RunSettings(domain="examples.cart:Cart")
    said = [
        (run / "run.json", "is no run but a part of the run '.*run'; give"),
        (run / "S0", "but a part of the run '.*run'"),
    ]
    for path, why in said:
        for use in (read_run, lambda path: planned_run(path, settings)):
            with pytest.raises(RunError, match=why):
                use(path)
    (run / "run.json").unlink()
    for use in (read_run, lambda path: planned_run(path, settings)):
        with pytest.raises(
            RunError, match=r"has parts of a run, and its run.json is lost; restore"
        ):
            use(run)


def test_data_of_another_type_are_told(trained: Trained, tmp_path: Path) -> None:
    path = copied(trained, tmp_path / "run") / "S1" / "data.safetensors"
    data = load_dataset(path)
    save_tensors(path, {**vars(data), "control": data.control.double()}, {})
    with pytest.raises(
        RunError, match=r"control of .*data.safetensors' is float64, and float32 is"
    ):
        load_dataset(path)


def test_a_skill_of_another_domain_is_told_with_its_file(trained: Trained, tmp_path: Path) -> None:
    path = copied(trained, tmp_path / "run") / "S1" / "skill.json"
    run = read_run(path.parents[1])
    data = json.loads(path.read_text())
    data["nodes"][0]["action"] = "Look"
    path.write_text(json.dumps(data))
    with pytest.raises(ActionError, match=r"in '.*/S1/skill.json', unknown action 'Look'"):
        load_skill(path, run.actions)
