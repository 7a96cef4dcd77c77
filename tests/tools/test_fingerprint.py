"""A fingerprint is that of what a run came to, wherever and whenever it was made."""

import shutil
from pathlib import Path

import pytest
from fingerprint import fingerprint

from cgtorch.ground.files import read_json, write_json

REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """runs/reference at another place."""
    return Path(shutil.copytree(REFERENCE, tmp_path / "copy"))


def test_a_place_and_times_change_no_fingerprint(copy: Path) -> None:
    log = copy / "log.jsonl"
    log.write_text(log.read_text().replace('"seconds": ', '"seconds": 1'))
    assert fingerprint(copy) == fingerprint(REFERENCE)


def test_a_node_changes_it(copy: Path) -> None:
    skill = read_json(copy / "S0" / "skill.json")
    skill["max_transitions"] += 1
    write_json(copy / "S0" / "skill.json", skill)
    assert fingerprint(copy) != fingerprint(REFERENCE)
