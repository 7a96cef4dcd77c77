"""The tabletop world and its scenarios."""

from cgtorch.world.scenarios import EDGES as EDGES
from cgtorch.world.scenarios import PLACEMENTS as PLACEMENTS
from cgtorch.world.scenarios import Scenarios as Scenarios
from cgtorch.world.scenarios import concatenate_scenarios as concatenate_scenarios
from cgtorch.world.scenarios import random_scenarios as random_scenarios
from cgtorch.world.scenarios import stage_scenarios as stage_scenarios
from cgtorch.world.tabletop import LAB_NOISE as LAB_NOISE
from cgtorch.world.tabletop import Noise as Noise
from cgtorch.world.tabletop import TabletopWorld as TabletopWorld
from cgtorch.world.tabletop import motion_possible as motion_possible
from cgtorch.world.tabletop import percept_of as percept_of
