"""Robots from URDF files: forward and inverse kinematics, collision, and what can be grasped."""

from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.description import Arm, RobotDescription, load_description
from cgtorch.tabletop.kinematics.files import robot_files, robots_folder
from cgtorch.tabletop.kinematics.grasping import GraspSolution, grasp_solution, graspable
from cgtorch.tabletop.kinematics.robot import Robot, load_robot
from cgtorch.tabletop.kinematics.urdf import Urdf, load_urdf

__all__ = [
    "Arm",
    "ArmModel",
    "GraspSolution",
    "Robot",
    "RobotDescription",
    "Urdf",
    "grasp_solution",
    "graspable",
    "load_description",
    "load_robot",
    "load_urdf",
    "robot_files",
    "robots_folder",
]
