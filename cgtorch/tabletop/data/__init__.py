"""Collecting transitions and grasp labels from a world."""

from cgtorch.tabletop.data.collect import collect as collect
from cgtorch.tabletop.data.labels import grasp_labels as grasp_labels
from cgtorch.tabletop.data.labels import label as label
from cgtorch.tabletop.data.poses import Scenes as Scenes
