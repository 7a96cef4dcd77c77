"""TensorBoard's files as the report reads them."""

from pathlib import Path

import pytest
from torch.utils.tensorboard import SummaryWriter

from cgtorch.report.page.event_files import read_event_files


def test_steps_that_a_resumed_run_repeats_are_read_once_without_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    for suffix, steps in ((".0", range(6)), (".1", range(3, 8))):
        where, first = str(tmp_path), steps.start or None
        with SummaryWriter(where, purge_step=first, filename_suffix=suffix) as writer:
            for step in steps:
                writer.add_scalar("fitness/best", step, step)
    assert read_event_files(tmp_path).scalars["fitness/best"] == tuple(
        (step, float(step)) for step in range(8)
    )
    assert not caplog.records
    assert capfd.readouterr().err == ""
