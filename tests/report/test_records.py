"""Records of TensorBoard files, read by TensorBoard's own reader."""

import time
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cgtorch.report import tensorboard
from cgtorch.report.tensorboard import TensorBoardWatch


def scalars(folder: Path, tag: str) -> list[tuple[int, float]]:
    events = EventAccumulator(str(folder))
    events.Reload()
    return [(e.step, e.value) for e in events.Scalars(tag)]


def test_what_is_written_together_has_its_own_steps_and_times(tmp_path: Path) -> None:
    written, began = TensorBoardWatch(tmp_path, {}), time.time()
    for step in range(3):
        written.step = step
        written.scalars({"a": step / 2, "b": -step})
        time.sleep(0.02)
    written.close()
    assert scalars(tmp_path, "a") == [(0, 0.0), (1, 0.5), (2, 1.0)]
    assert scalars(tmp_path, "b") == [(0, 0.0), (1, -1.0), (2, -2.0)]
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    times = [e.wall_time - began for e in events.Scalars("a")]
    assert 0 <= times[0] < times[1] - 0.015 < times[2] - 0.03


def test_nobody_waits_longer_than_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = TensorBoardWatch(tmp_path, {})
    written.scalars({"a": 1.0})
    written.step = 1
    monkeypatch.setattr(tensorboard, "SOON", -1.0)  # everything has waited for long enough
    written.scalars({"a": 2.0})
    written._writer.flush()  # of TensorBoard's own thread, not of what waits here
    assert scalars(tmp_path, "a") == [(0, 1.0), (1, 2.0)]
    written.close()


def test_what_earlier_files_hold_is_not_written_again(tmp_path: Path) -> None:
    written = TensorBoardWatch(tmp_path, {}, first_step=2)
    for step in range(4):
        written.step = step
        written.scalars({"a": float(step)})
    written.close()
    assert scalars(tmp_path, "a") == [(2, 2.0), (3, 3.0)]
