"""The four experiments of section VI and their scenarios."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from reaching import TABLE

from cgtorch.ground.errors import SettingsError
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, round_name
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world.scenarios import INSET_MIN, TABLE_DEPTH, TABLE_WIDTH
from cgtorch.training.train import stage_generator, stages_to_make

RUN = StoredRun(Path("none"), RunSettings(), TABLE, paper_actions())
STAGES = TABLE.stages


def test_stages_in_order() -> None:
    assert STAGES == {"S0": "near", "S1": "left", "S2": "right", "S3": "far"}
    assert [stages_to_make(RUN, s) for s in STAGES] == [
        ("S0",), ("S0", "S1"), ("S0", "S1", "S2"), ("S0", "S1", "S2", "S3"),
    ]  # fmt: skip


@pytest.mark.parametrize("bad", ["S4", "s0", "", "S0 ", "near", "../S0", "auto", "auto-1"])
def test_unknown_stages(bad: str) -> None:
    with pytest.raises(SettingsError, match=r"unknown stage .*; use one of S0, S1, S2, S3"):
        stages_to_make(RUN, bad)


def test_only_the_papers_table_has_stages() -> None:
    for scenarios in ("auto", "perimeter"):
        assert stages_to_make(replace(RUN, settings=RunSettings(scenarios=scenarios)), "S0")
    for other in ("general", "general-clutter"):
        with pytest.raises(SettingsError, match=f"not {other}; use stage 'auto'"):
            stages_to_make(replace(RUN, settings=RunSettings(scenarios=other)), "S0")


@pytest.mark.parametrize("stage", STAGES)
def test_five_evenly_spaced_from_the_centred_start(stage: str) -> None:
    tests = TABLE.tests(STAGES[stage])
    placed, pose = tests.object, tests.pose
    assert torch.equal(pose, pose[:1].expand(5, 3))
    assert pose[0].tolist() == pytest.approx([-TABLE_DEPTH / 2 - 1, 0, 0])
    along, across = (1, 0) if STAGES[stage] in ("near", "far") else (0, 1)
    length, depth = (TABLE_WIDTH, TABLE_DEPTH) if along == 1 else (TABLE_DEPTH, TABLE_WIDTH)
    gaps = placed[:, along].diff()
    assert gaps.tolist() == pytest.approx([(length - 2 * INSET_MIN) / 4] * 4)
    inside = depth / 2 - 0.1
    sign = 1 if STAGES[stage] in ("far", "left") else -1
    assert placed[:, across].tolist() == pytest.approx([sign * inside] * 5)


def test_the_right_edge_has_its_top_corner() -> None:
    placed = TABLE.tests(STAGES["S2"]).object
    corner = torch.tensor([TABLE_DEPTH / 2 - INSET_MIN, 0.1 - TABLE_WIDTH / 2])
    assert (placed - corner).norm(dim=1).min() < 1e-6


def test_a_stage_has_randomness_of_its_own() -> None:
    def drawn(seed: int, stage: str) -> tuple[float, ...]:
        return tuple(torch.rand(4, generator=stage_generator(TABLE, seed, stage)).tolist())

    names = [*STAGES, *map(round_name, range(1, 30))]
    everything = {drawn(seed, stage) for seed in range(20) for stage in names}
    assert len(everything) == 20 * len(names)
    assert drawn(3, "S2") == drawn(3, "S2")
    drawn(2**31 - 1, "S3")  # the largest seed that settings allow
