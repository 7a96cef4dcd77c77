"""Settings: what a run is begun with, kept as plain data, every bad value refused in one line."""

import json
import math
from dataclasses import fields
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.errors import SettingsError
from cgtorch.tabletop.network_presets import NETWORKS as KINDS_OF_NETWORKS
from cgtorch.runs.settings import (
    CHOICES,
    LATER,
    NETWORKS,
    PERCEPTS,
    SCENARIOS,
    RunSettings,
    settings_from_dict,
)
from cgtorch.tabletop.world import DRAWS
from cgtorch.tabletop.world import PERCEPTS as SIZES_OF_PERCEPTS

COUNTS = [f.name for f in fields(RunSettings) if isinstance(f.default, int)]
SIZES = [f.name for f in fields(RunSettings) if isinstance(f.default, float)]
LEAST = {"seed": 0, "population": 2, "practice": 0, "transitions": 50, "labels": 60}


def refused(**values: Any) -> str:
    with pytest.raises(SettingsError) as caught:
        RunSettings(**values)
    message = str(caught.value)
    assert "\n" not in message
    return message


@given(
    st.fixed_dictionaries(
        {name: st.integers(LEAST.get(name, 1), 2**31 - 1) for name in COUNTS}
        | {name: st.floats(0, 10) for name in SIZES}
        | {name: st.sampled_from(choices) for name, choices in CHOICES.items()}
        | {
            "actions": st.lists(st.text(max_size=10), max_size=3).map(tuple),
        }
    )
)
def test_round_trip(values: dict[str, Any]) -> None:
    settings = RunSettings(**values)
    assert settings_from_dict(json.loads(json.dumps(settings.to_dict()))) == settings


@pytest.mark.parametrize("name", COUNTS)
def test_counts(name: str) -> None:
    least = LEAST.get(name, 1)
    assert getattr(RunSettings(**{name: least}), name) == least
    for bad in (least - 1, -(2**40), 2**31, 1.0, math.nan, "5", None, True, [5]):
        assert f"{name} is {bad!r}; give a whole number of at least {least}" in refused(
            **{name: bad}
        )


@pytest.mark.parametrize("name", SIZES)
def test_sizes(name: str) -> None:
    assert getattr(RunSettings(**{name: 0}), name) == 0
    for bad in (-1e-9, 11, 1e39, 10**400, math.inf, -math.inf, math.nan, "0.1", None, [0.1], True):
        assert f"{name} is {bad!r:.40}; give a number from 0 to 10" in refused(**{name: bad})


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("bad", ["", "Compose", "near", None, 3, ["compose"]])
def test_choices(name: str, bad: Any) -> None:
    message = refused(**{name: bad})
    assert message == f"{name} is {bad!r}; use one of {', '.join(CHOICES[name])}"


def test_what_can_be_chosen_exists() -> None:
    assert set(SCENARIOS) <= set(DRAWS)
    assert set(PERCEPTS) == {"auto", *SIZES_OF_PERCEPTS}
    assert set(NETWORKS) == {"auto", *KINDS_OF_NETWORKS}


def test_a_run_from_before_there_were_other_tables() -> None:
    data = RunSettings(scenarios="general", percept="yaw", seed=3).to_dict()
    for name in LATER:
        del data[name]
    before = RunSettings(seed=3, scenarios="perimeter", percept="box", networks="percept")
    assert settings_from_dict(data) == before


@pytest.mark.parametrize("bad", [(1,), ("Wait", None), 5, None, "Wait"])
def test_actions(bad: Any) -> None:
    assert "give names" in refused(actions=bad)


@pytest.mark.parametrize("data", [None, 3, "text", [], {}, {"seed": 0}])
def test_what_are_no_settings(data: Any) -> None:
    with pytest.raises(SettingsError, match="is unknown or missing"):
        settings_from_dict(data)


@pytest.mark.parametrize("name", [f.name for f in fields(RunSettings)])
def test_a_wrong_setting_in_a_file(name: str) -> None:
    data = RunSettings().to_dict()
    for bad in ({}, [[]], -1, {"a": 1}):
        with pytest.raises(SettingsError) as caught:
            settings_from_dict({**data, name: bad})
        assert name in str(caught.value)


@pytest.mark.parametrize("name", [f.name for f in fields(RunSettings) if f.name not in LATER])
def test_a_setting_missing_in_a_file(name: str) -> None:
    data = RunSettings().to_dict()
    del data[name]
    with pytest.raises(SettingsError, match=f"'{name}' is unknown or missing"):
        settings_from_dict(data)


def test_an_unknown_setting_in_a_file() -> None:
    with pytest.raises(SettingsError, match="'colour' is unknown or missing"):
        settings_from_dict({**RunSettings().to_dict(), "colour": "red"})
