"""Collecting transitions and grasp labels from a world."""

from cgtorch.tabletop.data.collect import collect as collect
from cgtorch.tabletop.data.labels import grasp_labels as grasp_labels
from cgtorch.tabletop.data.labels import label as label
from cgtorch.tabletop.data.motions import WITHIN as WITHIN
from cgtorch.tabletop.data.motions import motions_to_try as motions_to_try
from cgtorch.tabletop.data.motions import random_motions as random_motions
from cgtorch.tabletop.data.poses import Scenes as Scenes
