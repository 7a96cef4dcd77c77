"""Robots from URDF files: forward and inverse kinematics, collision, and grasps."""

from cgtorch.tabletop.kinematics.arm import ArmModel as ArmModel
from cgtorch.tabletop.kinematics.arm_way import ArmWay as ArmWay
from cgtorch.tabletop.kinematics.arm_way import arm_ways as arm_ways
from cgtorch.tabletop.kinematics.arm_way import graspable as graspable
from cgtorch.tabletop.kinematics.description import load_description as load_description
from cgtorch.tabletop.kinematics.description import robot_files as robot_files
from cgtorch.tabletop.kinematics.description import robots_folder as robots_folder
from cgtorch.tabletop.kinematics.grasping import has_posture as has_posture
from cgtorch.tabletop.kinematics.robot import Robot as Robot
from cgtorch.tabletop.kinematics.robot import load_robot as load_robot
from cgtorch.tabletop.kinematics.urdf import load_urdf as load_urdf
