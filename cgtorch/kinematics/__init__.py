"""Robots from URDF files: forward and inverse kinematics, collision, and what can be grasped."""

from cgtorch.kinematics.arm import ArmModel
from cgtorch.kinematics.description import Arm, RobotDescription, load_description
from cgtorch.kinematics.files import robot_files, robots_folder
from cgtorch.kinematics.grasping import GraspSolution, grasp_solution, graspable
from cgtorch.kinematics.robot import Robot, load_robot
from cgtorch.kinematics.urdf import Urdf, load_urdf

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
