"""Work shared out to processes: the results in order, errors as they are."""

import os
import signal

import pytest
import torch
from stand_in import labelled

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.ground.processes import in_processes
from cgtorch.svm import SVC, grid_search


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_results_come_in_order_and_are_told(processes):
    told = []
    found = in_processes(lambda number: (number, os.getpid()), 5, processes, told.append)
    assert [number for number, _ in found] == list(range(5))
    assert sorted(told) == sorted(found)
    assert (os.getpid() in {process for _, process in found}) == (processes == 1)


def test_an_error_comes_back_as_it_is():
    def work(number: int) -> int:
        if number == 1:
            raise SettingsError("this one")
        return number

    with pytest.raises(SettingsError, match="this one"):
        in_processes(work, 3, 2, lambda _: None)


def test_a_killed_process_is_told():
    def work(number: int) -> int:
        os.kill(os.getpid(), signal.SIGKILL)
        return number

    with pytest.raises(DataError, match="was killed"):
        in_processes(work, 3, 2, lambda _: None)


def test_the_number_of_processes_changes_no_score():
    x, y = labelled(120)
    grid = {"C": [1.0, 8.0], "gamma": [0.1, 0.5, 2.0]}
    found = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        try:
            found.append(grid_search(SVC(), x, y, **grid))
        finally:
            torch.set_num_threads(1)
    assert torch.equal(found[0].held_out, found[1].held_out)
    assert torch.equal(found[0].scores, found[1].scores)
