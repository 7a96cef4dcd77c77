"""Which settings of the tabletop cannot work, and which are fixed in a run."""

import math
from dataclasses import fields

import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.settings import TabletopSettings


@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("noise", ("seeded", "fresh")),
        ("percept", ("auto", "box", "yaw")),
        ("world", ("kinematic", "mujoco")),
        ("touch", ("fails", "allowed")),
        ("grasp", ("way", "posture")),
        ("networks", ("auto", "percept", "edge")),
    ],
)
def test_words_are_among_the_choices(name: str, choices: tuple[str, ...]) -> None:
    for choice in choices:
        assert getattr(TabletopSettings(**{name: choice}), name) == choice  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match=f"{name} is 'other'.*{', '.join(choices)}"):
        TabletopSettings(**{name: "other"})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["position_noise", "heading_noise"])
def test_noise_is_neither_negative_nor_larger_than_a_room(name: str) -> None:
    for value in (0.0, 10.0):
        assert getattr(TabletopSettings(**{name: value}), name) == value  # type: ignore[arg-type]
    for value in (-1e-9, 10.1, math.nan):
        with pytest.raises(SettingsError, match=f"{name} is "):
            TabletopSettings(**{name: value})  # type: ignore[arg-type]


def test_runs_of_earlier_versions_have_what_these_did() -> None:
    """What a run.json does not say is what the library did before there was a choice."""
    before = {f.name: f.metadata.get("before") for f in fields(TabletopSettings)}
    assert {name: value for name, value in before.items() if isinstance(value, str)} == {
        "noise": "seeded", "world": "kinematic", "touch": "fails", "grasp": "posture",
    }  # fmt: skip
    assert all(field.metadata["fixed"] for field in fields(TabletopSettings))
