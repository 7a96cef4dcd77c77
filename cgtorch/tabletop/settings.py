"""The settings of the tabletop."""

import math
from dataclasses import dataclass
from typing import ClassVar

from cgtorch.domains.settings import DomainSettings, option

WORLDS = "kinematic", "mujoco"


@dataclass(frozen=True)
class TabletopSettings(DomainSettings):
    """The robot, its world's noise and its percepts; SettingsError for an impossible value."""

    usual_stage: ClassVar[str] = "S2"

    robot: str = option(
        "pr2",
        "The robot: pr2, fetch, a folder with a URDF and a robot.json, or a robot.json.",
        "the run has its robot already",
        when="Change it to train another robot.",
    )
    urdf: str = option(
        "",
        "The robot's URDF, if it does not lie beside its description.",
        "the run has its robot already",
        when="Give it if a description has no URDF beside it.",
    )
    position_noise: float = option(
        0.005,
        "Standard deviation of the noise of odometry and detection, m.",
        "W was solved under it",
        least=0,
        most=10,
        when="Set it to what your robot's odometry and detector have.",
    )
    heading_noise: float = option(
        math.pi / 360,
        "Standard deviation of the noise of the heading after a motion, rad.",
        "W was solved under it",
        least=0,
        most=10,
        when="Set it to what your robot's odometry has.",
    )
    noise: str = option(
        "seeded",
        "Whether noise repeats: seeded (a scenario has its own noise, so every trial can be made "
        "again) or fresh (drawn anew at every motion and look, as for a real robot).",
        "W was solved under it",
        choices=("seeded", "fresh"),
        when="Use fresh to see how a robot would learn that is never put back.",
        before="seeded",
    )
    percept: str = option(
        "auto",
        "The percept: box (the paper's seven numbers), yaw (the table's yaw as well), or auto "
        "(yaw for general scenarios, else box).",
        "the data and models of the run depend on it",
        choices=("auto", "box", "yaw"),
        when="Use yaw if tables stand at any angle.",
    )
    world: str = option(
        "kinematic",
        "The simulation in place of the real robot: kinematic, where a grasp succeeds if an arm "
        "has a way to the object, or mujoco, where it is carried out in physics (pip install "
        "'cgtorch[physics]').",
        "its data, models, W and M come from that world",
        choices=WORLDS,
        when="Use mujoco if contacts decide whether a grasp succeeds; it takes far longer.",
        before="kinematic",
    )
    touch: str = option(
        "fails",
        "In physics, what a touch of table or robot by the arm does to a grasp: fails, or allowed.",
        "its data and models depend on it",
        choices=("fails", "allowed"),
        when="Use allowed if your robot may touch the table or itself.",
        before="fails",
    )
    grasp: str = option(
        "way",
        "What a grasp needs: way for a way of the arm from home to the object that touches "
        "nothing, posture for a posture at the object alone.",
        "it says what success means, for labels and W",
        choices=("way", "posture"),
        when="Use posture to compare with runs of earlier versions.",
        before="posture",
    )
    networks: str = option(
        "auto",
        "The input of networks: percept (as in the paper), edge (the scene relative to the table "
        "edge nearest to the object), or auto (percept for --method paper, else edge).",
        "the graphs of the run contain them",
        choices=("auto", "percept", "edge"),
        when="Use percept to reproduce the publication.",
    )
