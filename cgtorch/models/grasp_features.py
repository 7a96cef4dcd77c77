"""What C sees of a percept: the object in polar coordinates, and the table as far as arms reach."""

import torch
from torch import Tensor

SIZE = 7
"""Coordinates of a tabletop percept."""
NEAR = 0.5
"""Distance over which a side of the table stops to matter, m."""
STRETCH = 4.0
"""Weight of the object's distance, in which success changes over centimetres."""
TURN = 2.0
"""Weight of its direction."""


def grasp_features(percept: Tensor) -> Tensor:
    """Features (..., 7) of tabletop percepts (..., 7); percepts of another size stay as they are.

    They are the four sides of the table's box, each saturated at `NEAR`, as what lies beyond the
    reach of the arms changes nothing; the object's distance, and the two numbers of its direction.
    An arm reaches a ring about its shoulder, not a box. The object's height is that of the table,
    which never changes, and is left out.
    """
    if percept.shape[-1] != SIZE:
        return percept
    sides = NEAR * torch.tanh(percept[..., :4] / NEAR)
    placed = percept[..., 4:6]
    distance = placed.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    return torch.cat([sides, STRETCH * distance, TURN * placed / distance], -1)
