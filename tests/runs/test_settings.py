"""Settings: what a run is begun with, kept as plain data, every bad value refused in one line."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeAlias

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch.domains.settings import DomainSettings, from_plain, to_plain
from cgtorch.ground.errors import SettingsError
from cgtorch.runs.settings import (
    NAMES,
    SCENARIOS,
    Goal,
    RunSettings,
    all_fields,
    defaults_of,
    help_of,
    option_of,
)
from cgtorch.tabletop.domain import ACTIONS
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.tabletop.world import PERCEPTS

Kind: TypeAlias = type[RunSettings] | type[TabletopSettings]
KINDS: tuple[Kind, ...] = (RunSettings, TabletopSettings)
EVERY = [(kind, f) for kind in KINDS for f in fields(kind)]
COUNTS = [f.name for f in fields(RunSettings) if isinstance(f.default, int)]
SIZES = [f.name for f in fields(TabletopSettings) if isinstance(f.default, float)]
CHOICES = {f.name: (kind, f.metadata["choices"]) for kind, f in EVERY if f.metadata["choices"]}
TEXTS = [
    (kind, f.name) for kind, f in EVERY if isinstance(f.default, str) and f.name not in CHOICES
]
LEAST = {"seed": 0, "population": 2, "practice": 0, "lineages": 0, "transitions": 12}


def refused(kind: Kind, **values: Any) -> str:
    with pytest.raises(SettingsError) as caught:
        kind(**values)
    message = str(caught.value)
    assert "\n" not in message
    return message


def any_of(kind: Kind) -> st.SearchStrategy[dict[str, Any]]:
    """Values of all settings of a kind."""

    def values(f: Any) -> st.SearchStrategy[Any]:
        if f.name in CHOICES:
            return st.sampled_from(CHOICES[f.name][1])
        if isinstance(f.default, int):
            return st.integers(LEAST.get(f.name, 1), 2**31 - 1)
        if isinstance(f.default, float):
            return st.floats(0, 10)
        if isinstance(f.default, str):
            return st.text(max_size=10)
        return st.lists(st.text(max_size=10), max_size=3).map(tuple)

    return st.fixed_dictionaries({f.name: values(f) for f in fields(kind)})


@given(any_of(RunSettings), any_of(TabletopSettings))
@settings(max_examples=30, deadline=None)
def test_round_trip(of_run: dict[str, Any], of_tabletop: dict[str, Any]) -> None:
    for found in (RunSettings(**of_run), TabletopSettings(**of_tabletop)):
        assert from_plain(type(found), json.loads(json.dumps(to_plain(found)))) == found


@pytest.mark.parametrize("name", COUNTS)
def test_counts(name: str) -> None:
    least = LEAST.get(name, 1)
    assert getattr(RunSettings(**{name: least}), name) == least
    for bad in (least - 1, -(2**40), 2**31, 1.0, math.nan, "5", None, True, [5]):
        bound = f"at most {2**31 - 1}" if bad == 2**31 else f"at least {least}"
        assert f"{name} is {bad!r}; give a whole number of {bound}" in refused(
            RunSettings, **{name: bad}
        )


def test_no_exploration_without_data() -> None:
    assert refused(RunSettings, transitions=0) == (
        "transitions is 0, and there is nothing else to learn Γ and C from; give at least 12, or "
        "files of logged transitions as data (--data)"
    )
    assert RunSettings(transitions=0, data=("log.csv",)).transitions == 0
    for bad in (1, 11, -1, 0.0, False):
        said = f"transitions is {bad!r}; give a whole number of at least 12 or 0"
        assert refused(RunSettings, transitions=bad, data=("log.csv",)) == said


@pytest.mark.parametrize("name", SIZES)
def test_sizes(name: str) -> None:
    assert getattr(TabletopSettings(**{name: 0}), name) == 0
    for bad in (-1e-9, 11, 1e39, 10**400, math.inf, -math.inf, math.nan, "0.1", None, [0.1], True):
        message = refused(TabletopSettings, **{name: bad})
        assert f"{name} is {bad!r:.40}; give a number from 0 to 10" in message


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("bad", ["", "Compose", "near", None, 3, ["compose"]])
def test_choices(name: str, bad: Any) -> None:
    kind, choices = CHOICES[name]
    assert refused(kind, **{name: bad}) == f"{name} is {bad!r}; use one of {', '.join(choices)}"


@pytest.mark.parametrize(("kind", "name"), TEXTS)
@pytest.mark.parametrize("bad", [None, 3, ["tabletop"], True])
def test_texts(kind: Kind, name: str, bad: Any) -> None:
    assert refused(kind, **{name: bad}) == f"{name} is {bad!r}; give a text"


def test_what_can_be_chosen_exists() -> None:
    assert set(CHOICES["percept"][1]) == {"auto", *PERCEPTS}
    assert set(CHOICES["networks"][1]) == {"auto", *ACTIONS}


def test_no_setting_has_two_meanings() -> None:
    names = [f.name for f in all_fields(TabletopSettings)]
    assert len(names) == len(set(names))
    assert names[: len(NAMES)] == list(NAMES)


@dataclass(frozen=True)
class Slow(DomainSettings):
    """Settings of a domain whose motions are dear."""

    run_defaults: ClassVar[Mapping[str, Any]] = {"transitions": 60}


def test_a_domain_may_have_other_defaults_of_a_run() -> None:
    usual = {f.name: f.default for f in fields(RunSettings)}
    assert defaults_of(DomainSettings) == defaults_of(TabletopSettings) == usual
    assert defaults_of(Slow) == {**usual, "transitions": 60}


@pytest.mark.parametrize("bad", [(1,), ("Wait", None), 5, None, "Wait"])
def test_actions(bad: Any) -> None:
    assert "give names" in refused(RunSettings, actions=bad)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("data", [None, 3, "text", [], {}, {"seed": 0}])
def test_what_are_no_settings(kind: Kind, data: Any) -> None:
    with pytest.raises(SettingsError, match="is unknown or missing"):
        from_plain(kind, data)


@pytest.mark.parametrize(("kind", "name"), [(kind, f.name) for kind, f in EVERY])
def test_a_wrong_setting_in_a_file(kind: Kind, name: str) -> None:
    data = to_plain(kind())
    for bad in ({}, [[]], -1, {"a": 1}):
        with pytest.raises(SettingsError) as caught:
            from_plain(kind, {**data, name: bad})
        assert name in str(caught.value)


@pytest.mark.parametrize(("kind", "name"), [(kind, f.name) for kind, f in EVERY])
def test_a_setting_missing_in_a_file(kind: Kind, name: str) -> None:
    data = to_plain(kind())
    del data[name]
    before = {f.name: f.metadata.get("before") for f in fields(kind)}[name]
    if before is not None:  # a run from before there was this setting
        assert getattr(from_plain(kind, data), name) == before
        return
    with pytest.raises(SettingsError, match=f"'{name}' is unknown or missing"):
        from_plain(kind, data)


@pytest.mark.parametrize("kind", KINDS)
def test_an_unknown_setting_in_a_file(kind: Kind) -> None:
    with pytest.raises(SettingsError, match="'colour' is unknown or missing"):
        from_plain(kind, {**to_plain(kind()), "colour": "red"})


def test_what_is_usual_is_one_population_without_anything_of_ones_own() -> None:
    usual = RunSettings()
    assert (usual.domain, usual.seed, usual.islands) == ("tabletop", 0, 1)
    assert (usual.driver, usual.actions, usual.data) == ("", (), ())
    assert usual.practice == 0  # which leaves the number to the world
    assert (usual.models, usual.chance, usual.scenarios) == ("auto",) * 3


@pytest.mark.parametrize("kind", [RunSettings, Goal])
def test_every_setting_says_what_it_is_and_when_to_change_it(kind: type) -> None:
    for f in fields(kind):
        assert f.metadata["help"].endswith((".", "solved (target_return).")), f.name
        assert f.metadata["when"].endswith("."), f.name


def test_what_a_finished_run_was_made_with_is_fixed() -> None:
    fixed = {f.name for f in fields(RunSettings) if f.metadata["fixed"]}
    assert fixed == {
        "domain", "seed", "method", "models", "transitions", "scenarios", "driver", "actions",
        "data",
    }  # fmt: skip


def test_a_goal_is_a_share_or_a_return_within_limits() -> None:
    goal = Goal()
    assert (goal.screening, goal.decisive) == (1000, 4000)
    assert (Goal(target=0.9).screening, Goal(target=0.9).decisive) == (100, 400)
    assert Goal(target=-500.0, minutes=0).target == -500
    assert Goal(target=1e9).target == 1e9
    assert Goal(minutes=1e6, rounds=1).rounds == 1
    for wrong in ({"minutes": -0.1}, {"minutes": 1.1e6}, {"rounds": 0}, {"target": math.nan}):
        with pytest.raises(SettingsError, match=f"{next(iter(wrong))} is "):
            Goal(**wrong)


def test_the_kinds_of_scenarios_are_those_of_the_domain() -> None:
    by_name = {f.name: f for f in fields(RunSettings)}
    own = by_name["scenarios"]
    assert help_of(own, "tabletop", ()).startswith(f"{SCENARIOS} The tabletop has perimeter (")
    assert help_of(own, "mine:Own", ("a", "b")) == f"{SCENARIOS} This domain has a, b."
    assert help_of(own, "mine:Own", ()) == SCENARIOS
    assert help_of(by_name["seed"], "mine:Own", ("a",)) == "Seed of all random numbers."
    assert option_of("max_transitions") == "--max-transitions"
