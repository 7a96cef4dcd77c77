"""Collecting transitions and grasp labels from a world."""

from cgtorch.data.collect import collect as collect
from cgtorch.data.dataset import Dataset as Dataset
