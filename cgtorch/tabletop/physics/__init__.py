"""The tabletop in MuJoCo: masses, servos, contacts, and an object that can be pushed over."""

from cgtorch.tabletop.physics.model import Thing as Thing
from cgtorch.tabletop.physics.world import MujocoWorld as MujocoWorld
from cgtorch.tabletop.physics.world import Physics as Physics
