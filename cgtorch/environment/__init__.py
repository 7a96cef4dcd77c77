"""The interfaces between skills and worlds: scenarios, lanes, environments, datasets."""

from cgtorch.environment.dataset import Dataset as Dataset
from cgtorch.environment.environment import Environment as Environment
from cgtorch.environment.environment import Episode as Episode
from cgtorch.environment.environment import Lanes as Lanes
from cgtorch.environment.environment import Live as Live
from cgtorch.environment.environment import Rewarded as Rewarded
from cgtorch.environment.environment import ScenarioBatch as ScenarioBatch
from cgtorch.environment.environment import Seeded as Seeded
from cgtorch.environment.environment import rows_where as rows_where
from cgtorch.environment.environment import seeds_of as seeds_of
from cgtorch.environment.environment import start_lanes as start_lanes
