"""The .pt2 archive runs where cgtorch cannot be imported, and equals the library there."""

import io
import json
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from driving import Execution, by_the_library, reference, stacked
from exported import exported
from safetensors.torch import load_file, save_file
from support import world
from test_step import Learned, lone
from torch import Tensor

from cgtorch.export import to_module
from cgtorch.export.modules import ABOUT
from cgtorch.graphs import Action
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError

ELSEWHERE = """
import json, sys
sys.modules["cgtorch"] = None  # whoever imports it fails
import torch
from safetensors.torch import load_file, save_file

try:
    import cgtorch.graphs
    sys.exit("cgtorch can be imported")
except ImportError:
    pass
torch.set_num_threads(1)
extra = {"skill.json": ""}
step = torch.export.load("skill.pt2", extra_files=extra).module()
about = json.loads(extra["skill.json"])
given = load_file("given.safetensors")
request, control = torch.zeros_like(given["outcome"]), torch.zeros_like(given["control"])
for i, rows in enumerate(given["rows"].tolist()):
    place, mind = torch.zeros(about["place"], dtype=torch.long), torch.zeros(about["mind"])
    for t in range(rows):
        asked = step(given["percept"][t, i], given["outcome"][t, i], place, mind)
        request[t, i], control[t, i], place, mind = asked
save_file({"request": request, "control": control}, "found.safetensors")
"""


def elsewhere(data: bytes, runs: list[Execution], folder: Path) -> tuple[Tensor, Tensor, Tensor]:
    """Replay executions with an archive in a process without cgtorch.

    Whether all requests are right, the motions it asked for, and those of the library.
    """
    (folder / "skill.pt2").write_bytes(data)
    given = stacked(runs)
    save_file(given, folder / "given.safetensors")
    ended = subprocess.run(
        [sys.executable, "-c", ELSEWHERE], cwd=folder, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    found = load_file(folder / "found.safetensors")
    return given["request"] == found["request"], found["control"], given["control"]


@pytest.fixture
def archive(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The archive of the reference run's skill."""
    return exported("module", tmp_path_factory)


@pytest.mark.hostile
def test_a_thousand_percepts_without_cgtorch(archive: bytes, tmp_path: Path) -> None:
    _, skill = reference()
    runs, _ = by_the_library(skill, world(12, 70))
    hopeless = world(12, 4)
    hopeless.graspable = lambda at, table: torch.zeros(len(at), dtype=torch.bool)
    runs += by_the_library(skill, hopeless)[0]
    assert sum(len(run.percepts) for run in runs) >= 1000
    assert {run.end for run in runs} >= {"success", "timeout"}
    right, found, expected = elsewhere(archive, runs, tmp_path)
    assert right.all()
    assert expected.abs().sum() > 0
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


@pytest.mark.hostile
def test_an_action_with_weights_of_its_own(tmp_path: Path) -> None:
    torch.manual_seed(0)
    skill = lone(Learned())
    runs, _ = by_the_library(skill, world(0, 20))
    right, found, expected = elsewhere(to_module(skill, percept_size=7), runs, tmp_path)
    assert right.all()
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


@pytest.mark.hostile
def test_nothing_in_it_is_a_pickle_or_tells_where_it_was_made(archive: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(archive)) as files:
        content = {name: files.read(name) for name in files.namelist()}
    assert not [name for name in content if name.endswith((".pkl", ".pt")) and content[name]]
    assert not [name for name, data in content.items() if data[:1] == b"\x80" or data[:2] == b"PK"]
    assert not [name for name, data in content.items() if str(Path.home()).encode() in data]
    assert not [name for name, data in content.items() if b".py" in data]
    (about,) = (data for name, data in content.items() if name.endswith(ABOUT))
    assert json.loads(about)["skill"] == "S3"


class Decides(Learned):
    """Python decides by a number, which no graph can say."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, out = super().forward(lanes, parameters, environment)
        if lanes.percept[0, 0] > 1:
            lanes = replace(lanes, message=lanes.message + 1)
        return lanes, out


def test_an_action_that_torch_cannot_follow_is_named() -> None:
    mine: Action = Decides()
    with pytest.raises(
        ActionError, match=r"action 'Mine' cannot be exported: .*; export the skill"
    ):
        to_module(lone(mine), percept_size=7)
