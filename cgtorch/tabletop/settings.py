"""The settings of the tabletop."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from cgtorch.domains.settings import DomainSettings, option


@dataclass(frozen=True)
class TabletopSettings(DomainSettings):
    """The robot, its world's noise and its percepts; SettingsError for a value that cannot work."""

    run_defaults: ClassVar[Mapping[str, Any]] = {"labels": 5500}
    usual_stage: ClassVar[str] = "S2"

    robot: str = option(
        "pr2",
        "The robot: pr2, fetch, a folder with a URDF and a robot.json, or a robot description.",
        "the run has its robot already",
    )
    urdf: str = option(
        "",
        "Its URDF, if that is not the one beside the description.",
        "the run has its robot already",
    )
    position_noise: float = option(
        0.005, "Noise of odometry and detection, m.", "W was solved under it", least=0, most=10
    )
    heading_noise: float = option(
        math.pi / 360,
        "Noise of the heading after a motion, rad.",
        "W was solved under it",
        least=0,
        most=10,
    )
    percept: str = option(
        "auto",
        "What is seen: box as in the paper, yaw for the table's yaw too, auto for yaw with general "
        "scenarios only.",
        "the data and models that are there have it",
        choices=("auto", "box", "yaw"),
    )
    grasp: str = option(
        "way",
        "What a grasp needs: way for a way of the arm from home to the object that touches "
        "nothing, posture for a posture at the object alone.",
        "it says what success means, for labels and W",
        choices=("way", "posture"),
    )
    networks: str = option(
        "auto",
        "What networks read: percept as in the paper, edge for the scene as seen from the edge "
        "nearest to the object, auto for edge unless the method is paper.",
        "the graphs that are there are made of them",
        choices=("auto", "percept", "edge"),
    )
