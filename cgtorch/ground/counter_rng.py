"""Random numbers that belong to a scenario, for actions that are stochastic.

A `torch.Generator` gives its numbers in turn, so what a lane got would depend on the lanes beside
it. These numbers are a function of what they are for: Threefry-2x32 with 20 rounds (Salmon et al.,
"Parallel random numbers: as easy as 1, 2, 3", SC 2011) of the scenario's seed, of who draws, and of
how often that has been done. Like the noise of the world they are part of the scenario: the same
skill on the same scenario does the same, in any batch, in another skill, on any number of ranks.
"""

import math
import zlib

import torch
from torch import Tensor

ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
PARITY = 0x1BD11BDA
WORD = 0xFFFFFFFF


def threefry(key: tuple[Tensor, Tensor], counter: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Threefry-2x32 with 20 rounds, element by element.

    Key, counter and result are two tensors (...) long each, of 32-bit words, 0 … 2³² - 1.
    """
    keys = (*key, key[0] ^ key[1] ^ PARITY)
    x, y = (counter[0] + keys[0]) & WORD, (counter[1] + keys[1]) & WORD
    for number in range(20):
        turn = ROTATIONS[number % 8]
        x = (x + y) & WORD
        y = (((y << turn) & WORD) | (y >> (32 - turn))) ^ x
        if number % 4 == 3:
            step = number // 4 + 1
            x = (x + keys[step % 3]) & WORD
            y = (y + keys[(step + 1) % 3] + step) & WORD
    return x, y


def uniform(seed: Tensor, who: str, count: Tensor, size: int) -> Tensor:
    """(n, size) float32 random numbers in [0, 1), multiples of 2⁻²⁴; rows are independent.

    Args:
        seed: (n,) long, of each row's scenario.
        who: draws; another name gives other numbers.
        count: (n,) long, how often it has drawn for that scenario.
        size: numbers of a row.
    """
    name = zlib.crc32(who.encode())
    key = (seed & WORD)[:, None], ((seed >> 32) & WORD ^ name)[:, None]
    block = torch.arange((size + 1) // 2, device=seed.device)
    words = torch.stack(threefry(key, ((count & WORD)[:, None], block)), 2).flatten(1)
    return (words[:, :size] >> 8).float() * 2.0**-24


def normal(numbers: Tensor) -> Tensor:
    """Standard normal numbers (n, k) from uniform ones (n, 2k) in [0, 1).

    Box and Muller's transformation ("A note on the generation of random normal deviates", 1958).
    """
    radius, angle = numbers.chunk(2, 1)
    return (-2 * torch.log(1 - radius)).sqrt() * torch.cos(2 * math.pi * angle)
