"""Settings as dataclasses of options: defaults, plain data, and every bad value in one line."""

import json
import math
from dataclasses import dataclass, fields
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rail import RailSettings

from cgtorch.domains.settings import (
    MOST,
    DomainSettings,
    from_plain,
    option,
    to_plain,
)
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.given import known_options


def refused(**values: Any) -> str:
    with pytest.raises(SettingsError) as caught:
        RailSettings(**values)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "wind": st.floats(0, 2),
            "carts": st.integers(1, MOST),
            "colour": st.sampled_from(("red", "blue")),
            "stops": st.lists(st.text(max_size=9), max_size=3).map(tuple),
        },
    )
)
def test_settings_go_through_a_file(values: dict[str, Any]) -> None:
    settings = RailSettings(**values)
    assert from_plain(RailSettings, json.loads(json.dumps(to_plain(settings)))) == settings


def test_options_have_a_default_and_what_is_said_of_them() -> None:
    about = {f.name: f for f in fields(RailSettings)}
    assert about["wind"].default == 0.25
    assert about["wind"].metadata["help"] == "Strongest wind, m."
    assert (about["wind"].metadata["least"], about["wind"].metadata["most"]) == (0, 2)
    assert about["wind"].metadata["fixed"] == ""
    assert about["carts"].metadata["fixed"] == "there are as many"
    assert about["colour"].metadata["choices"] == ("red", "blue")


@pytest.mark.parametrize("bad", [0, -3, MOST + 1, 2.0, math.nan, "2", None, True, [2]])
def test_a_count_is_a_whole_number_from_one_on(bad: object) -> None:
    bound = f"at most {MOST}" if bad == MOST + 1 else "at least 1"
    assert refused(carts=bad) == f"carts is {bad!r}; give a whole number of {bound}"


@pytest.mark.parametrize("bad", [-0.1, 2.1, math.nan, math.inf, "1", None, True, [1.0]])
def test_a_number_lies_within_its_bounds(bad: object) -> None:
    assert refused(wind=bad) == f"wind is {bad!r}; give a number from 0 to 2"


def test_a_whole_number_is_a_number() -> None:
    assert RailSettings(wind=1).wind == 1


@pytest.mark.parametrize("bad", ["green", "", 3, None, ("red",)])
def test_a_text_is_one_of_its_choices(bad: object) -> None:
    assert refused(colour=bad) == f"colour is {bad!r}; use one of red, blue"


@pytest.mark.parametrize("bad", ["north", ["north"], None, (1,), ("north", None)])
def test_names_are_in_a_tuple(bad: object) -> None:
    assert refused(stops=bad) == f"stops are {bad!r}; give names in a tuple"


def test_any_text_will_do_where_there_are_no_choices() -> None:
    @dataclass(frozen=True)
    class Labelled(DomainSettings):
        label: str = option("", "What stands on it.")

    assert Labelled(label="§ 1").label == "§ 1"
    with pytest.raises(SettingsError, match="label is 1; give a text"):
        Labelled(label=1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("data", "odd"),
    [
        ({}, "carts"),
        ({"wind": 0.1, "carts": 1, "colour": "red", "stops": [], "zeal": 1}, "zeal"),
        ({"wind": 0.1, "carts": 1, "colour": "red"}, "stops"),
        (None, "None"),
        (["wind"], r"\['wind'\]"),
    ],
)
def test_plain_data_of_other_settings_are_refused(data: object, odd: str) -> None:
    with pytest.raises(SettingsError, match=f"{odd}.* is unknown or missing"):
        from_plain(RailSettings, data)


def test_plain_data_are_checked_like_settings() -> None:
    with pytest.raises(SettingsError, match="wind is 9; give a number from 0 to 2"):
        from_plain(RailSettings, to_plain(RailSettings()) | {"wind": 9})


def test_a_domain_without_settings_has_none() -> None:
    assert fields(DomainSettings) == ()
    assert to_plain(DomainSettings()) == {}
    assert from_plain(DomainSettings, {}) == DomainSettings()


@pytest.mark.parametrize("reach", [math.inf, -math.inf, 2.5])
def test_numbers_without_end_go_through_a_file_as_text(reach: float) -> None:
    @dataclass(frozen=True)
    class Far(DomainSettings):
        reach: float = option(math.inf, "How far.", least=-math.inf, most=math.inf)
        colour: str = option("inf", "A text that looks like one.")

    text = json.dumps(to_plain(Far(reach)), allow_nan=False)
    assert from_plain(Far, json.loads(text)) == Far(reach)
    assert from_plain(Far, json.loads(text)).colour == "inf"
    with pytest.raises(SettingsError, match="reach is 'nan'; give a number"):
        from_plain(Far, {"reach": "nan", "colour": ""})


def test_a_setting_that_is_unknown_is_told_what_may_be_meant() -> None:
    given_ = {"wind": 1.0, "stops": ["a", "b"]}
    assert known_options(RailSettings, given_) == {"wind": 1.0, "stops": ("a", "b")}
    with pytest.raises(SettingsError, match=r"unknown setting 'winds'; did you mean 'wind'\?"):
        known_options(RailSettings, {"winds": 1.0})
    names = ", ".join(f.name for f in fields(RailSettings))
    with pytest.raises(SettingsError, match=f"unknown setting 'zzz'; use one of {names}$"):
        known_options(RailSettings, {"zzz": 1.0})

    @dataclass
    class Others:
        speed: float = 1.0

    with pytest.raises(SettingsError, match=r"unknown setting 'sped'; did you mean 'speed'\?"):
        known_options(RailSettings, {"sped": 1.0}, Others)
    with pytest.raises(SettingsError, match=r"unknown setting 'speed'; did you mean 'speed'\?"):
        known_options(RailSettings, {"speed": 1.0}, Others)
