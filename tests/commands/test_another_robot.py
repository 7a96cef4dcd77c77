"""Another robot than the PR2: its name is all that changes."""

import json
from pathlib import Path

from command_line import Shell, as_options
from trained import SMALL

from cgtorch.tabletop.kinematics import robots_folder

OPTIONS = as_options(SMALL)


def test_a_small_run_of_the_fetch_reaches_the_near_edge(shell: Shell, tmp_path: Path) -> None:
    run = tmp_path / "run"
    ended = shell(
        "cgtorch-train", "--robot", "fetch", "--stage", "S0", "--run-dir", run, "--quiet", *OPTIONS
    )
    assert ended.code == 0, ended
    for kept, source in (("robot.urdf", "fetch.urdf"), ("robot.json", "robot.json")):
        kept_bytes = (run / "robot" / kept).read_bytes()
        assert kept_bytes == (robots_folder() / "fetch" / source).read_bytes()
    ended = shell("cgtorch-evaluate", run, "--scenarios", "near", "--count", 200, "--json")
    assert ended.code == 0, ended
    assert json.loads(ended.out)["rate"] > 0.8
    words = ["cgtorch-train", "--stage", "S0", "--run-dir", run, "--quiet", *OPTIONS]
    message = shell.refuses(*words)
    assert "has robot fetch, not pr2, and cannot change it, as the run has its robot" in message
    assert shell(*words, "--robot", "fetch").code == 0
