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

from cgtorch.ground.environment import Environment, start_lanes


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

    step, look, test = (
        next((getattr(module, name) for name in names if hasattr(module, name)), None)
        for names in (("MoveBase", "Step"), ("Detect", "Perceive"), ("Grasp", "Test"))
    )

    class Drive(step):  # type: ignore[misc, valid-type]
        def step(self, userdata: Any, *motion: float) -> bool:
            return do("control", userdata, motion) == 0

    class Look(look):  # type: ignore[misc, valid-type]
        def perceive(self, userdata: Any) -> list[float]:
            do("perceive", userdata)
            return userdata.percept

    class Try(test):  # type: ignore[misc, valid-type]
        def test(self, userdata: Any) -> bool:
            return do("test", userdata) == 0

    return {base.__name__: own for base, own in ((step, Drive), (look, Look), (test, Try))}


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
