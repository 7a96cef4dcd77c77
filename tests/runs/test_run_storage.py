"""What a run keeps comes back to the last bit."""

import json
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded
from trained import Trained

from cgtorch.graphs import skill_to_dict
from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.runs.storage import (
    load_dataset,
    load_progress,
    load_scenarios,
    load_tensors,
    save_progress,
    save_scenarios,
    save_tensors,
    scenarios_from_list,
    scenarios_to_list,
)
from cgtorch.runs.stored_run import read_run
from cgtorch.tabletop.world import Scenarios, cluttered_scenarios, random_scenarios

LIKE = random_scenarios("near", 0, seeded(0))
LIKE_CLUTTER = cluttered_scenarios(0, seeded(0))


@pytest.mark.parametrize("stage", ["start", "S0", "S1"])
def test_progress_comes_back_to_the_last_bit(trained: Trained, stage: str, tmp_path: Path) -> None:
    run = read_run(trained.folder)
    progress = load_progress(run, run.folder / stage)
    save_progress(tmp_path, progress, run.settings.seed)
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    was = {path.name: path.read_bytes() for path in (run.folder / stage).iterdir()}
    assert set(kept) == set(was)
    for name in kept:
        if name.endswith(".json"):
            one, other = json.loads(kept[name]), json.loads(was[name])
            assert one == {key: value for key, value in other.items() if key != "was"}
    again = load_progress(run, tmp_path)
    assert (again.skill is None) == (stage == "start")
    if again.skill is not None and progress.skill is not None:
        assert skill_to_dict(again.skill) == skill_to_dict(progress.skill)
    for one, other in (
        (progress.solved, again.solved),
        (progress.missed, again.missed),
        (progress.knowledge.dataset, again.knowledge.dataset),
    ):
        for key, value in vars(one).items():
            assert torch.equal(value, vars(other)[key]), key
    for model, same in (
        (progress.knowledge.gamma, again.knowledge.gamma),
        (progress.knowledge.classifier, again.knowledge.classifier),
    ):
        state = same.state_dict()
        assert all(torch.equal(v, state[k]) for k, v in model.state_dict().items())
    assert again.knowledge.gamma_report == progress.knowledge.gamma_report
    assert again.knowledge.classifier_report == progress.knowledge.classifier_report
    if progress.specialists is not None and again.specialists is not None:
        for key, value in vars(progress.specialists.graphs).items():
            assert torch.equal(value, vars(again.specialists.graphs)[key])
        assert torch.equal(progress.specialists.strategy, again.specialists.strategy)


float32 = st.floats(-(2.0**49), 2.0**49, width=32)


@given(
    st.lists(
        st.tuples(st.lists(float32, min_size=11, max_size=11), st.integers(0, 2**63 - 1)),
        max_size=4,
    )
)
def test_scenarios_of_any_numbers(rows: list[tuple[list[float], int]]) -> None:
    numbers = torch.tensor([row for row, _ in rows]).view(-1, 11)
    seed = torch.tensor([s for _, s in rows], dtype=torch.long)
    scenarios = Scenarios(numbers[:, :3], numbers[:, 3:9], numbers[:, 9:], seed)
    again = scenarios_from_list(scenarios_to_list(scenarios), LIKE, "here")
    for name, value in vars(scenarios).items():
        assert torch.equal(value, getattr(again, name))
        assert value.dtype == getattr(again, name).dtype


@pytest.mark.parametrize("count", [0, 5])
def test_obstacles_are_kept_and_what_has_none_is_written_as_before(count: int) -> None:
    cluttered = cluttered_scenarios(count, seeded(0))
    data = json.loads(json.dumps(scenarios_to_list(cluttered)))
    again = scenarios_from_list(data, LIKE_CLUTTER, "here")
    for name, value in vars(cluttered).items():
        assert torch.equal(value, getattr(again, name))
    for row in scenarios_to_list(random_scenarios("near", count, seeded(0))):
        assert list(row) == ["pose", "table", "object", "seed"]


def test_numbers_may_be_whole() -> None:
    (one,) = scenarios_from_list([GOOD], LIKE, "here").pose.tolist()
    assert one == [0.0, 1.5, 2.0]
    whole = scenarios_from_list([{**GOOD, "pose": [0, 1, 2]}], LIKE, "here")
    assert whole.pose.dtype == torch.float32


GOOD = {"pose": [0, 1.5, 2], "table": [0, 0, 0, 1, 1, 1], "object": [0, 0], "seed": 1}


@pytest.mark.parametrize(
    "bad",
    [
        None,
        "near",
        {"0": GOOD},
        [None],
        [[]],
        [{}],
        [{**GOOD, "colour": 1}],
        [{k: v for k, v in GOOD.items() if k != "seed"}],
        [{**GOOD, "pose": [0, 1]}],
        [{**GOOD, "pose": 3}],
        [{**GOOD, "obstacles": 3}],
        [{**GOOD, "obstacles": [[0, 0, 0, 1]]}],
        [{**GOOD, "obstacles": [[0, 0, 0, 1, None]]}],
        [{**GOOD, "obstacles": [[0, 0, 0, 1, 1]]}, GOOD],
        [{**GOOD, "pose": [0, 1, "2"]}],
        [{**GOOD, "pose": [0, 1, None]}],
        [{**GOOD, "pose": [0, 1, True]}],
        [{**GOOD, "object": [1e15, 0]}],
        [{**GOOD, "object": [10**400, 0]}],
        [{**GOOD, "object": [float("nan"), 0]}],
        [{**GOOD, "seed": -(2**63) - 1}],
        [{**GOOD, "seed": 2**63}],
        [{**GOOD, "seed": 1.0}],
        [{**GOOD, "seed": True}],
    ],
)
def test_what_are_no_scenarios(bad: object) -> None:
    scenarios_from_list([GOOD], LIKE, "here")
    for like in (LIKE, LIKE_CLUTTER):
        with pytest.raises(RunError, match="here is ") as caught:
            scenarios_from_list(bad, like, "here")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 300


def test_a_batch_of_scenarios_that_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "scenarios.json"
    save_scenarios(path, scenarios_from_list([GOOD], LIKE, "here"), LIKE)
    assert [len(batch) for batch in load_scenarios(path, LIKE)] == [1, 0]
    path.write_text(json.dumps({"W": json.loads(path.read_text())["W"]}))
    with pytest.raises(RunError, match="lacks 'M'"):
        load_scenarios(path, LIKE)
    path.write_text("3")
    with pytest.raises(RunError, match="lacks 'W'"):
        load_scenarios(path, LIKE)


def test_tensor_files(tmp_path: Path) -> None:
    path = tmp_path / "some.safetensors"
    tensors = {"a": torch.randn(3, 2).T, "b": torch.tensor([True, False])}
    save_tensors(path, tensors, {"seed": "3"})
    again = load_tensors(path, {"a", "b"})
    assert all(torch.equal(value, again[name]) for name, value in tensors.items())
    for names in ({"a"}, {"a", "b", "c"}, set()):
        with pytest.raises(RunError, match="lacks or has tensor"):
            load_tensors(path, names)
    for other in (tmp_path / "none", tmp_path):
        with pytest.raises(RunError, match="cannot read"):
            load_tensors(other, {"a"})
    with path.open("wb") as file:
        file.truncate(2**34)  # sparse, so it takes no room
    with pytest.raises(RunError, match="larger than"):
        load_tensors(path, {"a"})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("percept", torch.zeros(3, 7)),
        ("percept", torch.zeros(4, 6)),
        ("percept", torch.full((4, 7), float("nan"))),
        ("percept", torch.zeros(4, 7, dtype=torch.long)),
        ("control", torch.zeros(4)),
        ("next_percept", torch.full((4, 7), float("inf"))),
        ("tested", torch.zeros(2, 7)),
        ("succeeded", torch.zeros(3)),
        ("succeeded", torch.zeros(3, 1, dtype=torch.bool)),
    ],
)
def test_data_that_do_not_fit(tmp_path: Path, name: str, value: torch.Tensor) -> None:
    good = {
        "percept": torch.zeros(4, 7),
        "control": torch.zeros(4, 3),
        "next_percept": torch.zeros(4, 7),
        "tested": torch.zeros(3, 7),
        "succeeded": torch.zeros(3, dtype=torch.bool),
    }
    path = tmp_path / "data.safetensors"
    save_tensors(path, good, {})
    load_dataset(path)
    save_tensors(path, {**good, name: value}, {})
    with pytest.raises(
        CgtorchError, match=r"do not fit one another or are not finite|, and \w+ is wanted"
    ):
        load_dataset(path)
