import math
import re
import struct
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from reaching import TABLE
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cgtorch.domains.knowledge import Knowledge, summary_of
from cgtorch.evolution.fitness import WORST
from cgtorch.evolution.population import STRATEGY
from cgtorch.ground.errors import RunError
from cgtorch.ground.statistics import Acceptance
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import (
    AboutToKeep,
    Event,
    EvolutionRecalled,
    FreshTested,
    GenerationDone,
    ModelsFitted,
    SkillAccepted,
    WorldTested,
)
from cgtorch.report import TensorBoardWatch
from cgtorch.report import tensorboard as module
from cgtorch.tabletop.actions import paper_actions

SETTINGS = {"population": 60, "seed": 3, "stages": ("S0", "S1"), "quiet": True, "device": "cpu"}
ALL = {"scalars": 0, "histograms": 0, "images": 0, "tensors": 0}
drawing = partial(TensorBoardWatch, draw_scenarios=TABLE.pictures(TABLE).scenarios)


def read(folder: Path) -> EventAccumulator:
    found = EventAccumulator(str(folder), size_guidance=ALL)
    found.Reload()
    return found


@pytest.fixture(scope="module")
def written(events: list[Event], tmp_path_factory: pytest.TempPathFactory) -> EventAccumulator:
    folder = tmp_path_factory.mktemp("run") / "tensorboard"
    watch = drawing(folder, SETTINGS, actions=paper_actions(), picture_seconds=0)
    with watch:
        for event in events:
            watch(event)
    assert watch.step == 48
    assert len([p for p in folder.iterdir() if p.is_file()]) == 1
    return read(folder)


def documented() -> dict[str, set[str]]:
    """The tags of the table in docs/report.md by kind, placeholders filled in."""
    text = (Path(__file__).parents[2] / "docs" / "report.md").read_text()
    kinds: dict[str, set[str]] = {}
    for tags, kind in re.findall(
        r"^\| (`.+`) \| (scalar|histogram|image|text) \|", text, re.MULTILINE
    ):
        kinds.setdefault(kind, set()).update(re.findall(r"`(.+?)`", tags))
    kinds["histogram"] = {f"strategy/{name}" for name in STRATEGY}
    kinds["scalar"] -= {"gamma/error_<coordinate>", "world/mean_return"}
    for what in ("table", "object"):
        ends = ("x_min", "x_max", "y_min", "y_max") if what == "table" else ("x", "y", "z")
        kinds["scalar"] |= {f"gamma/error_{what}_{end}" for end in ends}
    return kinds


def test_files_hold_exactly_the_documented_tags(written: EventAccumulator) -> None:
    wanted, tags = documented(), written.Tags()
    assert len(wanted["scalar"]) > 20
    assert set(tags["scalars"]) == wanted["scalar"]
    assert set(tags["histograms"]) == wanted["histogram"]
    assert set(tags["images"]) == wanted["image"]
    assert wanted["image"] == {"graph/best", "scenarios/solved", "classifier/reliability"}
    assert set(tags["tensors"]) == {"settings/text_summary"}


def test_scalars_of_each_generation(written: EventAccumulator, events: list[Event]) -> None:
    told = [e for e in events if isinstance(e, GenerationDone)]
    best = [float(e.generation.fitness.max()) for e in told]
    wanted = {
        "fitness/best": best,
        "fitness/mean": [float(e.generation.fitness.mean()) for e in told],
        "solved/W": [e.solved_w for e in told],
        "solved/M": [e.solved_m for e in told],
        "graph/nodes_best": [int(e.generation.champion.graphs.num_nodes) for e in told],
        "graph/nodes_mean": [
            float((e.generation.population.graphs.action >= 0).sum()) / 60 for e in told
        ],
        "population/unsolved": [float((e.generation.fitness == 0).sum()) / 60 for e in told],
        "population/not_finite": [0.0] * len(told),
        "population/distinct_parents": [float(e.generation.distinct_parents) for e in told],
        "speed/transitions_per_second": [e.generation.executed / e.seconds for e in told],
    }
    for tag, values in wanted.items():
        scalars = written.Scalars(tag)
        assert [s.step for s in scalars] == list(range(1, 48)), tag
        assert [s.value for s in scalars] == pytest.approx(values, rel=1e-5), tag
    assert len(set(best)) > 1  # the evolution has got somewhere


def test_models_and_world(
    written: EventAccumulator, events: list[Event], knowledge: Knowledge
) -> None:
    gamma, classifier = knowledge.gamma_report, knowledge.classifier_report
    wanted = {
        "gamma/error_table_x_min": gamma.error[0],
        "gamma/error_object_z": gamma.error[6],
        "classifier/balanced_accuracy": classifier.balanced_accuracy,
        "classifier/calibration_error": classifier.calibration_error,
        "models/fit_seconds": 1.5,
        "models/rows": 120,
    }
    for tag, value in wanted.items():
        (scalar,) = written.Scalars(tag)
        assert (scalar.step, scalar.value) == (0, pytest.approx(value, rel=1e-5)), tag
    assert [s.step for s in written.Scalars("world/solved_W")] == [46, 48, 48]
    (fresh,) = written.Scalars("world/fresh_rate")
    assert (fresh.step, fresh.value) == (48, 0.75)
    accepted = events[-1]
    assert isinstance(accepted, SkillAccepted)
    (targets,) = written.Scalars("stage/targets")
    assert targets.value == int((accepted.succeeded & accepted.targets).sum())


def test_learning_curves_have_rows_as_their_step(
    events: list[Event], tmp_path: Path, knowledge: Knowledge
) -> None:
    fitted = next(e for e in events if isinstance(e, ModelsFitted))
    with TensorBoardWatch(tmp_path, {}) as watch:
        watch(fitted)
    found = read(tmp_path / module.BY_ROWS)
    curve = knowledge.classifier_report.learning_curve
    for kind, scores in (("train", curve.train_scores), ("test", curve.test_scores)):
        drawn = found.Scalars(f"classifier/learning_curve/{kind}")
        assert [s.step for s in drawn] == list(curve.sizes)
        means = [sum(row) / len(row) for row in scores]
        assert [s.value for s in drawn] == pytest.approx(means, rel=1e-5)


def test_learning_on_repeats_nothing_of_the_first_fit(
    events: list[Event], tmp_path: Path, knowledge: Knowledge
) -> None:
    fitted = next(e for e in events if isinstance(e, ModelsFitted))
    same = Acceptance(True, 10, 0.1, 0.1, 0.01)
    learned = replace(knowledge, acceptances=(same, same))
    later = replace(fitted, summary=summary_of(learned))
    with TensorBoardWatch(tmp_path, {}) as watch:
        for event in (fitted, later, later):
            watch(event)
    found = read(tmp_path)
    for tag in found.Tags()["scalars"]:
        times = 3 if tag.startswith("models/") else 1
        if tag.startswith(("models/", "gamma/", "classifier/")):
            assert len(found.Scalars(tag)) == times, tag
    assert len(found.Images("classifier/reliability")) == 1


def test_histograms_of_the_strategy(written: EventAccumulator, events: list[Event]) -> None:
    told = [e for e in events if isinstance(e, GenerationDone)]
    for i, name in enumerate(STRATEGY):
        histograms = written.Histograms(f"strategy/{name}")
        assert [h.step for h in histograms] == [1, 21, 41, 46]
        for h in histograms:
            values = told[h.step - 1].generation.population.strategy[:, i]
            seen = h.histogram_value
            assert seen.num == 60
            assert (seen.min, seen.max, seen.sum) == pytest.approx(
                (float(values.min()), float(values.max()), float(values.sum())), rel=1e-4
            )


def test_pictures_are_png_of_the_size_they_claim(written: EventAccumulator) -> None:
    assert [p.step for p in written.Images("graph/best")] == [46, 48, 48]
    assert [p.step for p in written.Images("scenarios/solved")] == [48]
    assert [p.step for p in written.Images("classifier/reliability")] == [0]
    for tag in ("graph/best", "scenarios/solved", "classifier/reliability"):
        for picture in written.Images(tag):
            data = picture.encoded_image_string
            assert data[:8] == b"\x89PNG\r\n\x1a\n"
            assert struct.unpack(">II", data[16:24]) == (picture.width, picture.height)
            assert 50 < picture.width < 4000
            assert 50 < picture.height < 4000


def test_hyper_parameters_are_in_the_same_file(written: EventAccumulator) -> None:
    summary = written.SummaryMetadata("_hparams_/session_start_info")
    assert summary.plugin_data.plugin_name == "hparams"
    text = summary.plugin_data.content
    for name in (*SETTINGS, "cpu", "('S0', 'S1')"):
        assert name.encode() in text
    content = written.SummaryMetadata("_hparams_/experiment").plugin_data.content
    for metric in module.METRICS:
        assert metric.encode() in content
        assert written.Scalars(metric)
    shown = written.Tensors("settings/text_summary")[0].tensor_proto.string_val[0].decode()
    assert "| population | 60 |" in shown


def test_a_run_goes_on_where_it_ended(events: list[Event], tmp_path: Path) -> None:
    """What a finished stage ends with stays; what an unfinished one left behind is hidden."""
    generations = [e for e in events if isinstance(e, GenerationDone)]
    first = drawing(tmp_path, SETTINGS)
    for event in [events[0], *generations[:10], events[-1]]:
        first(event)
    first.close()
    interrupted = drawing(tmp_path, SETTINGS, first_step=11)
    for event in [events[0], *generations[10:20], events[-1]]:
        interrupted(event)
    interrupted.close()
    time.sleep(1.1)  # TensorBoard orders files by the second
    again = drawing(tmp_path, SETTINGS, first_step=11)
    for event in [events[0], *generations[10:15]]:
        again(event)
    again.close()
    found = read(tmp_path)
    assert [s.step for s in found.Scalars("fitness/best")] == [*range(10), *range(11, 16)]
    assert [p.step for p in found.Images("scenarios/solved")] == [10]


def test_what_is_recalled_is_not_written_twice(events: list[Event], tmp_path: Path) -> None:
    """Ten generations are told, then recalled as eight: two of them are evaluated again."""
    generations = [e for e in events if isinstance(e, GenerationDone)]
    world = next(e for e in events if isinstance(e, WorldTested))
    whole = drawing(tmp_path / "whole", SETTINGS)
    killed = drawing(tmp_path / "killed", SETTINGS)
    for event in [events[0], world, *generations[:10]]:
        whole(event)
        killed(event)
    killed(AboutToKeep())  # and no close: it was killed
    time.sleep(1.1)
    again = drawing(tmp_path / "killed", SETTINGS, first_step=8, recalled=8)
    champion = generations[7].generation.champion
    again(events[0])
    again(world)
    found = Found(champion, torch.zeros(0, dtype=torch.bool), 0.5, generations=8)
    again(EvolutionRecalled("S1", generations[0].candidate, found))
    for event in [*generations[8:15], events[-1]]:
        again(event)
    for event in [*generations[10:15], events[-1]]:
        whole(event)
    again.close()
    whole.close()
    one, two = read(tmp_path / "whole"), read(tmp_path / "killed")
    for tag in ("fitness/best", "solved/M", "world/solved_W", "stage/targets"):
        pairs = ([(s.step, s.value) for s in each.Scalars(tag)] for each in (one, two))
        assert len({tuple(p) for p in pairs}) == 1, tag
    assert [p.step for p in two.Images("scenarios/solved")] == [15]


@pytest.mark.parametrize(
    ("more", "count", "steps"),
    [
        ({"picture_seconds": 0}, None, [48]),  # without actions, only accepted skills are drawn
        ({"actions": paper_actions()}, None, [46, 48]),  # pictures keep their distance
        ({"actions": paper_actions()}, 1, [1]),  # an evolution that is broken off is drawn, too
    ],
)
def test_which_graphs_are_drawn(
    events: list[Event], tmp_path: Path, more: dict[str, Any], count: int | None, steps: list[int]
) -> None:
    told = events if count is None else [e for e in events if isinstance(e, GenerationDone)][:count]
    with TensorBoardWatch(tmp_path, {}, **more) as watch:
        for event in told:
            watch(event)
    assert [p.step for p in read(tmp_path).Images("graph/best")] == steps


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"cannot write TensorBoard files to .*file"):
        TensorBoardWatch(tmp_path / "file" / "inside", {})


def test_importing_the_package_is_cheap() -> None:
    code = (
        "import sys, cgtorch.report; "
        "print([m for m in ('matplotlib', 'tensorboard') if m in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert out.strip() == "[]"


def test_watching_changes_nothing(events: list[Event], tmp_path: Path) -> None:
    event = next(e for e in events if isinstance(e, GenerationDone))
    before = event.generation.population.strategy.clone()
    state = torch.random.get_rng_state()
    with TensorBoardWatch(tmp_path, {}, actions=paper_actions()) as watch:
        watch(event)
    assert torch.equal(event.generation.population.strategy, before)
    assert torch.equal(torch.random.get_rng_state(), state)


def test_returns_are_written_where_there_are_some(events: list[Event], tmp_path: Path) -> None:
    told = next(e for e in events if isinstance(e, GenerationDone))
    fresh = FreshTested("S1", "S1", 3, 4, -2.0, decisive=False, mean_return=-2.5)
    lost, some = (
        replace(told, generation=replace(told.generation, fitness=torch.tensor(f), best=max(f)))
        for f in ([WORST, WORST / 100], [-4.0, -2.0, WORST, WORST / 1000])
    )
    with TensorBoardWatch(tmp_path, {}) as watch:
        for event in (lost, some, fresh):
            watch(event)
    found = read(tmp_path)
    assert [s.value for s in found.Scalars("world/mean_return")] == [-2.5]
    wanted = {"best": -2.0, "mean": -3.0}
    for name, value in wanted.items():
        first, second = found.Scalars(f"fitness/{name}")
        assert math.isnan(first.value)
        assert second.value == value
    assert [s.value for s in found.Scalars("population/unsolved")] == [1.0, 0.5]
