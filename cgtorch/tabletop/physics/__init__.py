"""The tabletop in MuJoCo: masses, servos, contacts, and an object that can be pushed over."""

from cgtorch.tabletop.physics.questions import Physics as Physics
from cgtorch.tabletop.physics.thing import Thing as Thing
from cgtorch.tabletop.physics.world import MujocoWorld as MujocoWorld
