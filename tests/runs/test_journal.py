"""The journal's files: what is kept, in what order it is read, and what damage does to it."""

from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from cgtorch.ground.errors import RunError
from cgtorch.ground.files import write_bytes
from cgtorch.improvement.checkpoint import Checkpoint
from cgtorch.improvement.events import AboutToKeep, Event, JournalDamaged
from cgtorch.runs.journal import FileJournal, journal_of, recalled_generations


def result(number: int) -> dict[str, Tensor]:
    return {"x": torch.full((3,), float(number)), "generations": torch.tensor(number)}


def checkpoint(number: int, parts: int = 1, apart: bool = False) -> Checkpoint:
    """Whose parts are 100, 101, … more than its number."""
    made = [partial(result, number + 100 + i) for i in range(parts)]
    return Checkpoint(result(number), tuple(made), apart)


def filled(folder: Path, steps: int, notes: int = 0) -> None:
    """A journal of so many steps, and so many notes of where the next one stands."""
    journal = FileJournal(folder, seconds=0)
    for i in range(steps):
        assert journal.recall(f"step {i}") is None
        journal.record(f"step {i}", result(i))
    for i in range(notes):
        journal.record_checkpoint(f"step {steps}", checkpoint(10 + i))


def numbers(folder: Path) -> list[float]:
    """What is recalled, in order."""
    journal, found = FileJournal(folder), []
    while (known := journal.recall(f"step {len(found)}")) is not None:
        found.append(float(known["x"][0]))
    return found


def test_steps_are_recalled_in_their_order(tmp_path: Path) -> None:
    filled(tmp_path / "S0", 3, notes=1)
    journal = FileJournal(tmp_path / "S0")
    assert journal.generations == 0 + 1 + 2 + 10
    assert numbers(tmp_path / "S0") == [0, 1, 2]
    for i in range(3):
        journal.recall(f"step {i}")
    assert journal.recall("step 3") is None
    known = journal.recall_checkpoint("step 3")
    assert known is not None
    assert float(known.about["x"][0]) == 10
    assert [float(part()["x"][0]) for part in known.parts] == [110]
    journal.record("step 3", result(3))
    assert numbers(tmp_path / "S0") == [0, 1, 2, 3]
    assert FileJournal(tmp_path / "S0").recall_checkpoint("step 4") is None


def test_another_step_than_the_journal_knows_is_an_error(tmp_path: Path) -> None:
    filled(tmp_path / "S0", 1, notes=1)
    with pytest.raises(RunError, match="goes on with 'step 0', not 'other'; remove it"):
        FileJournal(tmp_path / "S0").recall("other")
    journal = FileJournal(tmp_path / "S0")
    journal.recall("step 0")
    with pytest.raises(RunError, match="goes on with 'step 1', not 'other'"):
        journal.recall_checkpoint("other")


def test_the_last_two_notes_are_kept_and_a_damaged_one_gives_way_to_the_one_before(
    tmp_path: Path,
) -> None:
    filled(tmp_path, 1, notes=5)
    names = [f"00001-{note}{part}.safetensors" for note in (4, 5) for part in (".0", "")]
    assert sorted(p.name for p in tmp_path.glob("00001-*")) == names
    notes = [tmp_path / "00001-4.safetensors", tmp_path / "00001-5.safetensors"]
    notes[1].write_bytes(notes[1].read_bytes()[:-1] + b"?")
    journal = FileJournal(tmp_path)
    assert journal.damaged == [notes[1]]
    known = journal.recall("step 0") and journal.recall_checkpoint("step 1")
    assert isinstance(known, Checkpoint)
    assert float(known.about["x"][0]) == 13


@given(step=st.integers(0, 3), place=st.integers(0, 10**6), bit=st.integers(0, 7))
@settings(max_examples=60, deadline=None)
def test_a_flipped_bit_costs_what_came_after_and_nothing_before(
    tmp_path_factory: pytest.TempPathFactory, step: int, place: int, bit: int
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    filled(folder, 4)
    path = folder / f"{step:05}.safetensors"
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= 1 << bit
    write_bytes(path, bytes(data))
    assert numbers(folder) == list(range(step))
    journal = FileJournal(folder)
    assert journal.damaged == [path]
    for i in range(step):
        journal.recall(f"step {i}")
    journal.record(f"step {step}", result(7))
    assert numbers(folder) == [*range(step), 7]  # what came after is not mixed with it


@given(data=st.binary(max_size=300))
@settings(max_examples=60, deadline=None)
def test_files_that_are_anything_are_named(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    (folder / "00000.safetensors").write_bytes(data)
    journal = FileJournal(folder)
    assert journal.damaged == [folder / "00000.safetensors"]
    assert journal.recall("step 0") is None


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    filled(tmp_path, 2)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "99.safetensors").write_text("mine, too")
    assert numbers(tmp_path) == [0, 1]
    filled(tmp_path / "again", 1)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_the_journal_goes_with_its_stage_and_an_interrupted_one_stays(tmp_path: Path) -> None:
    told: list[Event] = []
    with suppress(KeyboardInterrupt), journal_of(tmp_path, "S0", told.append) as journal:
        journal.record("step 0", result(4))
        journal.record_checkpoint("step 1", checkpoint(5))
        raise KeyboardInterrupt
    assert all(isinstance(event, AboutToKeep) for event in told)
    assert len(told) == 3  # the interruption kept where the step stood, in two files
    assert recalled_generations(tmp_path) == 9
    (tmp_path / "journal" / "S0" / "00000.safetensors").write_bytes(b"")
    told.clear()
    with journal_of(tmp_path, "S0", told.append) as journal:
        assert journal.recall("step 0") is None
    (damage,) = told
    assert isinstance(damage, JournalDamaged)
    assert damage.files[0].endswith("00000.safetensors")
    assert not (tmp_path / "journal" / "S0").exists()


def test_a_finished_stage_recalls_nothing(tmp_path: Path) -> None:
    filled(tmp_path / "journal" / "S0", 3)
    (tmp_path / "S0").mkdir()
    (tmp_path / "S0" / "skill.json").write_text("{}")
    assert recalled_generations(tmp_path) == 0


def test_a_folder_that_cannot_be_written_is_one_error(tmp_path: Path) -> None:
    (tmp_path / "S0").write_text("a file")
    with pytest.raises(RunError, match="cannot write"):
        FileJournal(tmp_path / "S0").record("step 0", result(0))


def test_types_that_numpy_lacks_are_kept_and_read(tmp_path: Path) -> None:
    tensors = {"x": torch.ones(3, dtype=torch.bfloat16), "y": torch.tensor(True)}
    FileJournal(tmp_path / "S0").record("step 0", tensors)
    journal = FileJournal(tmp_path / "S0")
    assert not journal.damaged
    known = journal.recall("step 0")
    assert known is not None
    assert known["x"].equal(tensors["x"])


@pytest.mark.parametrize(
    "count", [torch.tensor(float("inf")), torch.tensor(1j), torch.ones(2), torch.ones(0)]
)
def test_what_is_no_count_of_generations_is_none(tmp_path: Path, count: Tensor) -> None:
    FileJournal(tmp_path / "journal" / "S0").record("step 0", {"generations": count})
    assert recalled_generations(tmp_path) == 0


@given(
    parts=st.integers(1, 5), which=st.integers(0, 4), how=st.sampled_from(["gone", "cut", "old"])
)
@settings(max_examples=40, deadline=None)
def test_a_note_counts_only_with_all_its_parts(
    tmp_path_factory: pytest.TempPathFactory, parts: int, which: int, how: str
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    journal = FileJournal(folder, seconds=0)
    for number in (1, 2):
        journal.record_checkpoint("step 0", checkpoint(number, parts))
    path = folder / f"00000-2.{which % parts}.safetensors"
    match how:
        case "gone":
            path.unlink()
        case "cut":
            path.write_bytes(path.read_bytes()[:-1])
        case "old":  # whole, but another note's
            path.write_bytes((folder / f"00000-1.{which % parts}.safetensors").read_bytes())
    journal = FileJournal(folder)
    assert journal.damaged == [path]
    known = journal.recall_checkpoint("step 0")
    assert known is not None
    assert float(known.about["x"][0]) == 1
    assert [float(part()["x"][0]) for part in known.parts] == [101 + i for i in range(parts)]


def test_a_note_without_parts_is_none(tmp_path: Path) -> None:
    journal = FileJournal(tmp_path, seconds=0)
    journal.record_checkpoint("step 0", checkpoint(1))
    journal.record_checkpoint("step 0", Checkpoint(result(2), ()))
    journal = FileJournal(tmp_path)
    assert journal.damaged == [tmp_path / "00000-2.safetensors"]
    known = journal.recall_checkpoint("step 0")
    assert known is not None
    assert float(known.about["x"][0]) == 1


def test_parts_of_a_note_that_was_never_ended_are_no_note_and_go(tmp_path: Path) -> None:
    """As when the disk is full, or power fails, between two of them."""

    def fails() -> dict[str, Tensor]:
        raise OSError

    journal = FileJournal(tmp_path, seconds=0)
    journal.record_checkpoint("step 0", checkpoint(1, 2))
    with suppress(OSError):
        journal.record_checkpoint("step 0", Checkpoint(result(2), (checkpoint(2).parts[0], fails)))
    assert (tmp_path / "00000-2.0.safetensors").exists()
    journal = FileJournal(tmp_path, seconds=0)
    assert not journal.damaged
    known = journal.recall_checkpoint("step 0")
    assert known is not None
    assert float(known.about["x"][0]) == 1
    journal.record_checkpoint("step 0", checkpoint(3, 2))
    journal.record_checkpoint("step 0", checkpoint(4, 2))
    names = {f"00000-{note}{part}.safetensors" for note in (2, 3) for part in (".0", ".1", "")}
    assert {p.name for p in tmp_path.iterdir()} == names


def test_what_other_ranks_hold_is_not_asked_for_when_one_is_interrupted(tmp_path: Path) -> None:
    def never() -> dict[str, Tensor]:
        raise AssertionError

    with suppress(KeyboardInterrupt), FileJournal(tmp_path / "S0") as journal:
        journal.record_checkpoint("step 0", Checkpoint(result(1), (never,), apart=True))
        raise KeyboardInterrupt
    assert not (tmp_path / "S0").exists()
