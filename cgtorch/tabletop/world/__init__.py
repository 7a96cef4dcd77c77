"""The tabletop world and its scenarios."""

from cgtorch.tabletop.world.clear_way import ClearWay as ClearWay
from cgtorch.tabletop.world.clear_way import motion_possible as motion_possible
from cgtorch.tabletop.world.general import DRAWS as DRAWS
from cgtorch.tabletop.world.general import cluttered_scenarios as cluttered_scenarios
from cgtorch.tabletop.world.general import draw_of as draw_of
from cgtorch.tabletop.world.general import general_scenarios as general_scenarios
from cgtorch.tabletop.world.percepts import PERCEPTS as PERCEPTS
from cgtorch.tabletop.world.percepts import percept_of as percept_of
from cgtorch.tabletop.world.scenarios import EDGES as EDGES
from cgtorch.tabletop.world.scenarios import PLACEMENTS as PLACEMENTS
from cgtorch.tabletop.world.scenarios import Scenarios as Scenarios
from cgtorch.tabletop.world.scenarios import random_scenarios as random_scenarios
from cgtorch.tabletop.world.scenarios import stage_scenarios as stage_scenarios
from cgtorch.tabletop.world.tabletop import LAB_NOISE as LAB_NOISE
from cgtorch.tabletop.world.tabletop import Noise as Noise
from cgtorch.tabletop.world.tabletop import TabletopWorld as TabletopWorld
