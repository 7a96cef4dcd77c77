"""A skill as a skill file."""

import json

from cgtorch.graphs import Skill, skill_to_dict


def to_json(skill: Skill) -> bytes:
    """The same as `cgtorch.graphs.save_skill` writes and `load_skill` reads."""
    return json.dumps(skill_to_dict(skill), indent=1, allow_nan=False).encode() + b"\n"
