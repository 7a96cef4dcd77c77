"""A small robot with one of each: a slide, a continuous joint, a mimic, a box, a bar and a ball."""

from typing import Any

_ARM = (
    ("pan", "z", "0.1 0 0.2"), ("lift", "y", "0.1 0 0"), ("roll", "x", "0 0 0"),
    ("elbow", "y", "0.4 0 0"), ("forearm", "x", "0 0 0"), ("wrist", "y", "0.32 0 0"),
    ("hand", "x", "0 0 0"),
)  # fmt: skip
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
_SHAPES = ('<cylinder radius="0.05" length="0.2"/>', '<box size="0.2 0.1 0.05"/>')


def _urdf() -> str:
    parts = [
        '<robot name="small"><link name="base"><collision><origin xyz="0 0 0.3" rpy="0 0 0"/>'
        '<geometry><box size="0.5 0.5 0.6"/></geometry></collision></link>'
        '<link name="torso"/><joint name="slide" type="prismatic"><parent link="base"/>'
        '<child link="torso"/><origin xyz="0 0 0.6"/><axis xyz="0 0 1"/>'
        '<limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>'
    ]
    parent = "torso"
    for i, (name, axis, xyz) in enumerate(_ARM):
        kind = "continuous" if name in ("forearm", "hand") else "revolute"
        limit = "" if kind == "continuous" else 'lower="-2" upper="2" '
        parts.append(
            f'<link name="{name}_link"><collision><origin xyz="0.1 0 0"/><geometry>'
            f"{_SHAPES[i % 2]}</geometry></collision></link>"
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><origin xyz="{xyz}"/><axis xyz="{_AXES[axis]}"/>'
            f'<limit {limit}effort="1" velocity="1"/>'
            '<safety_controller soft_lower_limit="-1.9" soft_upper_limit="1.9" k_velocity="1"/>'
            "</joint>"
        )
        parent = f"{name}_link"
    for name, mimic in (("finger", ""), ("thumb", '<mimic joint="finger" multiplier="-1"/>')):
        parts.append(
            f'<link name="{name}_link"><collision><geometry><sphere radius="0.02"/></geometry>'
            f'</collision></link><joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><origin xyz="0.1 0 0"/><axis xyz="0 0 1"/>'
            f'<limit lower="-1" upper="1" effort="1" velocity="1"/>{mimic}</joint>'
        )
    parts.append(
        f'<link name="tool"/><joint name="end" type="fixed"><parent link="{parent}"/>'
        '<child link="tool"/><origin xyz="0.12 0 0"/></joint></robot>'
    )
    return "".join(parts)


URDF = _urdf()
WORDS: dict[str, Any] = {
    "name": "small",
    "base_frame": "base",
    "footprint": [-0.25, 0.25, -0.25, 0.25],
    "torso_joint": "slide",
    "torso_position": 0.1,
    "arms": [{"name": "arm", "base_link": "torso", "tool_frame": "tool"}],
    "body": ["base"],
    "gripper_joints": {"finger": 0.2},
    "capsules": {"elbow_link": [[0, 0, 0, 0.1, 0, 0, 0.05]]},
}
