"""Collecting transitions and grasp labels from a world."""

from cgtorch.data.collect import collect as collect
from cgtorch.data.dataset import Dataset as Dataset
from cgtorch.data.labels import grasp_labels as grasp_labels
from cgtorch.data.labels import label as label
from cgtorch.data.poses import Domain as Domain
from cgtorch.data.poses import domain_of as domain_of
