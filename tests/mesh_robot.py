"""A robot of the project's own whose links are meshes, in a package as ROS has them."""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix, translation_matrix

PACKAGE = "mesh_robot"
TIP, FLOOR = 0.19, 0.02  # m: the finger tips before the hand, the base's lower side
_ARM = (
    ("pan", "z", "0.15 0 0.3", 'lower="-2.2" upper="2.2"'),
    ("lift", "y", "0.1 0 0", 'lower="-0.6" upper="1.4"'),
    ("roll", "x", "0 0 0", 'lower="-2.5" upper="2.5"'),
    ("elbow", "y", "0.4 0 0", 'lower="-2.3" upper="0"'),
    ("forearm", "x", "0 0 0", None),
    ("wrist", "y", "0.32 0 0", 'lower="-2.1" upper="0"'),
    ("hand", "x", "0 0 0", None),
)
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def along_x(mesh: trimesh.Trimesh, start: float) -> trimesh.Trimesh:
    """A mesh about z turned to x, its lower end at a place."""
    mesh.apply_transform(rotation_matrix(np.pi / 2, [0, 1, 0]))
    mesh.apply_translation([start - mesh.bounds[0, 0], 0, 0])
    return mesh


def meshes() -> dict[str, trimesh.Trimesh]:
    """The mesh of each file, m."""
    corner = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.05, 0.3, 0.6), translation_matrix([0, 0, 0])),
            trimesh.creation.box((0.25, 0.2, 0.06), translation_matrix([0.1, 0, 0.27])),
        ]
    )
    base = trimesh.creation.box((0.5, 0.46, 0.3), translation_matrix([0, 0, FLOOR + 0.15]))
    return {
        "base.stl": base,
        "torso.stl": corner,
        "pan.obj": trimesh.creation.cylinder(0.06, 0.12, sections=24),
        "upper.stl": along_x(trimesh.creation.capsule(0.3, 0.05, count=(16, 16)), 0.02),
        "fore.dae": along_x(trimesh.creation.cylinder(0.045, 0.24, sections=20), 0.03),
        "palm.stl": trimesh.creation.box((0.08, 0.1, 0.05), translation_matrix([0.07, 0, 0])),
        "finger.stl": trimesh.creation.box((0.08, 0.012, 0.02), translation_matrix([0.04, 0, 0])),
    }  # fmt: skip


def _link(name: str, mesh: str | None, scale: str = "") -> str:
    shape = f'<geometry><mesh filename="package://{PACKAGE}/meshes/{mesh}"{scale}/></geometry>'
    parts = "" if mesh is None else f"<collision>{shape}</collision><visual>{shape}</visual>"
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" '
        'izz="0.01"/></inertial>'
    )
    return f'<link name="{name}">{inertial}{parts}</link>'


def _joint(name: str, kind: str, ends: tuple[str, str], xyz: str, rest: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz="{xyz}"/>{rest}</joint>'
    )


def text() -> str:
    """The URDF: a base, a torso that slides, an arm of seven joints, and two fingers."""
    files = [None, "pan.obj", None, "upper.stl", None, "fore.dae", None, "palm.stl"]
    limit = '<limit {} effort="10" velocity="1"/>'
    slide = '<axis xyz="0 0 1"/>' + limit.format('lower="0" upper="0.3"')
    parts = [
        _link("base_link", "base.stl"),
        _link("torso_link", "torso.stl"),
        _joint("torso_joint", "prismatic", ("base_link", "torso_link"), "-0.05 0 0.62", slide),
    ]
    parent = "torso_link"
    scale = ' scale="0.001 0.001 0.001"'
    for (name, axis, xyz, ends), file in zip(_ARM, files[1:], strict=True):
        link = f"{name}_link"
        parts.append(_link(link, file, scale if file == "fore.dae" else ""))
        turn = f'<axis xyz="{_AXES[axis]}"/>' + limit.format(ends or "")
        kind = "revolute" if ends else "continuous"
        parts.append(_joint(f"{name}_joint", kind, (parent, link), xyz, turn))
        parent = link
    for side, y, way in (("left", 0.01, "0 1 0"), ("right", -0.01, "0 -1 0")):
        parts.append(_link(f"{side}_finger", "finger.stl"))
        move = f'<axis xyz="{way}"/>' + limit.format('lower="0" upper="0.04"')
        ends = parent, f"{side}_finger"
        parts.append(_joint(f"{side}_joint", "prismatic", ends, f"{TIP - 0.08} {y} 0", move))
    return f'<robot name="mesh robot">{"".join(parts)}</robot>'


def write_package(folder: Path) -> Path:
    """Write the package into a folder; its URDF, beside which no mesh is."""
    package = folder / PACKAGE
    for part in ("meshes", "urdf"):
        (package / part).mkdir(parents=True)
    (package / "package.xml").write_text(f"<package><name>{PACKAGE}</name></package>")
    for name, mesh in meshes().items():
        if name == "fore.dae":
            mesh = mesh.copy().apply_scale(1000)
        mesh.export(package / "meshes" / name)
    urdf = package / "urdf" / "robot.urdf"
    urdf.write_text(text())
    return urdf
