"""The ledger: every skill that a run accepted, its parent, and the evidence for eq. 1.

RUN/ledger/index.json   the whole history, a few numbers for each skill, in the order of acceptance
RUN/ledger/NAME.json    one skill, with its result in the world on every scenario, one per line

A scenario was in "W", in "M" or "new" when the skill was tried on it; `succeeded` is the result.
Eq. 1a holds if none of W failed, eq. 1b if one of M succeeded. Noise is part of a scenario
(`cgtorch.improvement.trial`), so both hold exactly. `w_other_noise` counts the result of W under
other noise.

A stage whose skill misses fresh scenarios improves it again (`Setup.rounds`) and enters only its
last skill. W is then what that skill had to keep: the stage's W, and all that its own first skill
solved.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Skill
from cgtorch.graphs.files import skill_from_dict, skill_to_dict
from cgtorch.ground.environment import ScenarioBatch
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_versioned, write_bytes, write_json, writing
from cgtorch.improvement.events import SkillAccepted
from cgtorch.improvement.setup import Progress
from cgtorch.runs.storage import is_count, is_share, scenarios_from_list, scenarios_to_list

FOLDER, FORMAT, VERSION = "ledger", "cgtorch-ledger", 1
WAS = ("W", "M", "new")
_COUNTS = ("w_before", "w_lost", "m_before", "m_solved", "new", "new_solved", "nodes", "depth")


@dataclass(frozen=True)
class Entry:
    """An accepted skill with its evidence.

    Attributes:
        skill: The skill; its sub-skills are its members.
        parent: The name of the skill that it improved, None for the first.
        scenarios: All B scenarios that it was tried on.
        was: (B,) long, an index into `WAS`: where each scenario was before.
        succeeded: (B,) bool, in the world, with the scenario's own noise.
        other_noise: How many scenarios of W were "tried" under other noise, and how many of these
            "succeeded"; None if that was not tried.
    """

    skill: Skill
    parent: str | None
    scenarios: ScenarioBatch
    was: Tensor
    succeeded: Tensor
    other_noise: dict[str, int] | None = None

    @property
    def summary(self) -> dict[str, Any]:
        """The skill's line of the index."""
        w, m, new = (self.was == i for i in range(len(WAS)))
        return {
            "name": self.skill.name,
            "parent": self.parent,
            "members": list(self.skill.sub_skills),
            "w_before": int(w.sum()),
            "w_lost": int((w & ~self.succeeded).sum()),
            "m_before": int(m.sum()),
            "m_solved": int((m & self.succeeded).sum()),
            "new": int(new.sum()),
            "new_solved": int((new & self.succeeded).sum()),
            "nodes": self.skill.num_nodes,
            "depth": self.skill.depth,
            "w_other_noise": self.other_noise,
        }


def entry_of(
    accepted: SkillAccepted[Any],
    parent: Skill | None,
    after: Progress[Any],
    other_noise: dict[str, int] | None = None,
) -> Entry:
    """The entry of a skill that improved its parent; scenarios found only in `after` are new."""
    known = set(_keys(accepted.scenarios))
    parts, was, succeeded = [accepted.scenarios], [(~accepted.keep).long()], [accepted.succeeded]
    for scenarios, solved in ((after.solved, True), (after.missed, False)):
        fresh = [i for i, key in enumerate(_keys(scenarios)) if key not in known]
        parts.append(scenarios[torch.tensor(fresh, dtype=torch.long)])
        was.append(torch.full((len(fresh),), WAS.index("new")))
        succeeded.append(torch.full((len(fresh),), solved))
    name = None if parent is None else parent.name
    tried = parts[0].joined(*parts[1:]), torch.cat(was), torch.cat(succeeded)
    return Entry(accepted.skill, name, *tried, other_noise)


def _keys(scenarios: ScenarioBatch) -> list[str]:
    return [json.dumps(row) for row in scenarios_to_list(scenarios)]


def enter(folder: Path, entry: Entry) -> None:
    """Write a skill into the ledger of the run in `folder`: first the skill, then the index.

    It replaces a skill of the same name, for example of a repeated stage. RunError if the ledger is
    damaged or cannot be written.
    """
    ledger = folder / FOLDER
    with writing(ledger):
        ledger.mkdir(exist_ok=True)
    columns = entry.was.tolist(), entry.succeeded.tolist(), scenarios_to_list(entry.scenarios)
    rows = [{"was": WAS[w], "succeeded": s, **row} for w, s, row in zip(*columns, strict=True)]
    head = {"format": FORMAT, "version": VERSION, **entry.summary}
    text = json.dumps({**head, "skill": skill_to_dict(entry.skill)}, indent=1, allow_nan=False)
    lines = ",\n  ".join(json.dumps(row, allow_nan=False) for row in rows)
    text = f'{text.removesuffix("}").rstrip()},\n "scenarios": [\n  {lines}\n ]\n}}\n'
    write_bytes(ledger / f"{entry.skill.name}.json", text.encode())
    others = [s for s in read_index(folder) if s["name"] != entry.skill.name]
    index = {"format": FORMAT, "version": VERSION, "skills": [*others, entry.summary]}
    write_json(ledger / "index.json", index)


def read_index(folder: Path) -> list[dict[str, Any]]:
    """The summaries of all skills of the run in `folder`, oldest first; RunError if damaged."""
    path = folder / FOLDER / "index.json"
    if not path.is_file():
        return []
    skills = read_versioned(path, FORMAT, VERSION, "a ledger").get("skills")
    if not isinstance(skills, list) or not all(map(_is_summary, skills)):
        raise RunError(f"skills of {str(path)!r} are {skills!r:.60}; restore the file")
    return skills


def read_entry(folder: Path, name: str, actions: ActionSet, like: ScenarioBatch) -> Entry:
    """A skill of the ledger with its evidence; `like` are scenarios of the run's kind, perhaps 0.

    RunError if the ledger lacks it or is damaged, GraphError if the file contains no skill.
    """
    if name not in (names := [s["name"] for s in read_index(folder)]):
        known = f"one of {', '.join(names)}" if names else "another run; this one has no ledger"
        raise RunError(f"no skill {name!r:.40} in the ledger of {str(folder)!r}; give {known}")
    path = folder / FOLDER / f"{name}.json"
    data = read_versioned(path, FORMAT, VERSION, "a ledger")
    skill = skill_from_dict(data.get("skill"), actions)
    rows, parent, again = data.get("scenarios"), data.get("parent"), data.get("w_other_noise")
    if (
        skill.name != name
        or not (parent is None or isinstance(parent, str))
        or not (again is None or is_share(again))
        or not isinstance(rows, list)
        or not all(isinstance(r, dict) for r in rows)
        or not all(r.get("was") in WAS and isinstance(r.get("succeeded"), bool) for r in rows)
    ):
        raise RunError(f"{str(path)!r} is no entry of skill {name!r}; restore the file")
    plain = [{k: v for k, v in r.items() if k not in ("was", "succeeded")} for r in rows]
    return Entry(
        skill,
        parent,
        scenarios_from_list(plain, like, f"scenarios of {str(path)!r}"),
        torch.tensor([WAS.index(r["was"]) for r in rows], dtype=torch.long),
        torch.tensor([r["succeeded"] for r in rows], dtype=torch.bool),
        again,
    )


def _is_summary(data: Any) -> bool:
    # A name is part of a path, so it must not lead anywhere.
    return (
        isinstance(data, dict)
        and isinstance(data.get("name"), str)
        and re.fullmatch(r"\w[\w.-]{0,100}", data["name"]) is not None
        and all(is_count(data.get(key)) for key in _COUNTS)
        and (data.get("w_other_noise") is None or is_share(data["w_other_noise"]))
    )
