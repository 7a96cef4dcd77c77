"""Exported state machines, imported and run."""

import importlib.util
import logging
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from driving import act

from cgtorch.environment import Environment, start_lanes


def imported(data: bytes, folder: Path, name: str = "skill") -> ModuleType:
    path = folder / f"{name}.py"
    path.write_bytes(data)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look there
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[name]
    return module


def filled_in(module: ModuleType, environment: Environment, scenario: int) -> dict[str, Any]:
    """Classes that act in an environment, as a user would write them for a robot."""
    lanes = start_lanes(environment, torch.tensor([scenario]), 0, 0)

    def do(what: str, userdata: Any, motion: tuple[float, ...] = (0.0, 0.0, 0.0)) -> int:
        nonlocal lanes
        lanes, out = act(what, lanes, torch.tensor(motion), environment)
        userdata.percept = lanes.percept[0].tolist()
        return out

    class Drive(module.MoveBase):
        def move(self, userdata: Any, *motion: float) -> bool:
            return do("MoveBase", userdata, motion) == 0

    class Look(module.Detect):
        def detect(self, userdata: Any) -> list[float]:
            do("Detect", userdata)
            return userdata.percept

    class Grip(module.Grasp):
        def grasp(self, userdata: Any) -> bool:
            return do("Grasp", userdata) == 0

    return {"MoveBase": Drive, "Detect": Look, "Grasp": Grip}


def executed(
    module: ModuleType,
    environment: Environment,
    scenario: int,
    caplog: pytest.LogCaptureFixture,
    more: dict[str, Any] | None = None,
) -> tuple[list[tuple[str, str]], str]:
    """All actions with their outcomes, and the end."""
    caplog.clear()
    percept = environment.start(torch.tensor([scenario]))[1][0].tolist()
    states = {**filled_in(module, environment, scenario), **(more or {})}
    with caplog.at_level(logging.DEBUG, logger="skill"):
        end = module.run(percept, states)
    lines = [record.args for record in caplog.records if record.name == "skill"]
    return [(str(a[1]).rpartition("_")[0], str(a[2])) for a in lines if isinstance(a, tuple)], end
