"""Counter-based random numbers: functions of the scenario or individual that they belong to.

Numbers of a `torch.Generator` come in sequence, so those of a lane or an individual would depend on
its neighbours in the batch.
"""

import math
import zlib
from functools import cache
from typing import Any, TypeAlias

import torch
from torch import Generator, Tensor

Pair: TypeAlias = tuple[Any, Any]
"""Two tensors, or two arrays of numpy."""

ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
PARITY = 0x1BD11BDA
WORD = 0xFFFFFFFF
BITS = 24
"""The upper bits of a word that make a uniform number; the lower 40 make a normal one."""
GOLDEN, FIRST, SECOND = (
    constant - 2**64 for constant in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)
FEISTEL_ROUNDS = 6
FRESH, DRIFT = 2**40, 2**41
"""Where an individual's numbers for parameters of new nodes, and for its drift, begin."""
OCTAVES, STEPS = 40, 32
"""The quantile function is a polynomial on each step of each octave of probabilities."""


def threefry(key: Pair, counter: Pair) -> Pair:
    """Threefry-2x32 with 20 rounds, on pairs of arrays (...) long of 32-bit words, by element.

    They are tensors, or arrays of numpy, whose small operations take a quarter of the time.
    Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
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
    """(n, size) float32 random numbers in [0, 1) for stochastic actions; rows are independent.

    They follow from the seed (n,) of each row's scenario, the name `who` of the action's class, and
    the number of draws `count` (n,) so far: in any batch, skill and number of ranks the same.
    """
    name, block = zlib.crc32(who.encode()), torch.arange((size + 1) // 2, device=seed.device)
    own, number, block = (_as_array(x) for x in (seed[:, None], count[:, None], block))
    drawn = threefry((own & WORD, (own >> 32) & WORD ^ name), (number & WORD, block))
    words = torch.stack([torch.as_tensor(part) for part in drawn], 2).flatten(1)
    return (words[:, :size] >> 8).float() * 2.0**-24


def _as_array(x: Tensor) -> Any:
    """The same numbers as an array of numpy; on a GPU the tensor itself."""
    return x.numpy() if x.device.type == "cpu" else x


def normal(numbers: Tensor) -> Tensor:
    """Standard normal numbers (n, k) from uniform ones (n, 2k) in [0, 1).

    Box and Muller's transformation ("A note on the generation of random normal deviates", 1958).
    """
    radius, angle = numbers.chunk(2, 1)
    return (-2 * torch.log(1 - radius)).sqrt() * torch.cos(2 * math.pi * angle)


def random_key(generator: Generator) -> int:
    """A random word from which `keys` of all individuals follow."""
    return int(torch.empty((), dtype=torch.long).random_(generator=generator))


def keys(key: int, count: int) -> Tensor:
    """(count,) long, the key of each individual, from the random word of a generation."""
    return _mixed(key + GOLDEN * torch.arange(1, count + 1))


def words(keys: Tensor, numbers: Tensor) -> Tensor:
    """(...) long, 64 random bits for the `numbers` (...), from 0, of individuals' keys (...).

    Number i is the i-th of SplitMix64 with that key (Steele, Lea & Flood, "Fast splittable
    pseudorandom number generators", OOPSLA 2014), in any order and in any number of threads.
    """
    return _mixed(keys + GOLDEN * (numbers + 1))


def individual_words(key: int, count: int, sizes: list[int]) -> tuple[Tensor, ...]:
    """Words (count, size) of `count` individuals, in consecutive parts of these sizes."""
    return words(keys(key, count)[:, None], torch.arange(sum(sizes))).split(sizes, 1)


def uniform_from(words: Tensor) -> Tensor:
    """Float32 in [0, 1), multiples of 2^-24, from words (...)."""
    return fields(words).float() * 2.0**-BITS


def fields(words: Tensor) -> Tensor:
    """The integers (long) behind `uniform_from` words (...), for sorting."""
    return words >> 64 - BITS & 2**BITS - 1


def normal_from(words: Tensor) -> Tensor:
    """Standard normal numbers (float32) from words (...), up to 7.1 and with six digits."""
    chance = (words & 2 ** (OCTAVES - 1) - 1) * 2 + 1  # of 2^41, as a half of them is negative
    bits = chance.float().view(torch.int32)
    # The bits of a float are the octave, then the step in it, then the place in the step.
    a, b, c = quantiles()[((bits >> 18) - 127 * STEPS).long()].unbind(-1)
    place = (bits & 2**18 - 1).float() * 2.0**-18
    size = a + place * (b + place * c)
    return torch.where(words >> OCTAVES - 1 & 1 != 0, -size, size)


@cache
def quantiles() -> Tensor:
    """(1281, 3) float32, coefficients of the normal quantile of 2^e (1 + (k + t) / 32) / 2^41.

    The row of e and k holds coefficients of 1, t and t², which interpolate the ends and the middle
    of a step. A probability that is rounded up to 2^40 has the last row.
    """
    place = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)
    step = torch.arange(STEPS)[:, None]
    octave = torch.arange(OCTAVES, dtype=torch.float64)[:, None, None] - (OCTAVES + 1)
    at = torch.special.ndtri(torch.exp2(octave) * (1 + (step + place) / STEPS))
    first, middle, last = at.flatten(0, 1).unbind(1)
    rows = [first, 4 * middle - 3 * first - last, 2 * (first + last) - 4 * middle]
    table = -torch.stack(rows, 1).float()
    return torch.cat([table, torch.zeros(1, 3)])


def shuffled(count: int, key: int) -> Tensor:
    """(count,) long, a permutation of 0 … count - 1 that follows from a key.

    Each number's place follows from it alone, by a Feistel network on as many bits as `count`
    needs, repeated while the result is too large (Black & Rogaway, "Ciphers with arbitrary finite
    domains", 2002); `native/engine/draws.h` has the same.
    """
    bits = max(2, (count - 1).bit_length())
    low = bits // 2
    own, place = torch.tensor(key), torch.arange(count)
    todo = place.clone()
    while len(todo):
        now = place[todo]
        left, right = now >> low, now & (1 << low) - 1
        for turn in range(0, FEISTEL_ROUNDS, 2):
            left = (left ^ words(own, right * 8 + turn)) & (1 << bits - low) - 1
            right = (right ^ words(own, left * 8 + turn + 1)) & (1 << low) - 1
        place[todo] = left << low | right
        todo = todo[place[todo] >= count]
    return place


def pick(draw: Tensor, count: Tensor | int) -> Tensor:
    """⌊draw · count⌋ (...) long from draws (...) in [0, 1); 0 where the count is 0.

    In float32, a draw close to 1 can round up to the count itself, and then counts as the last.
    """
    last = torch.as_tensor(count) - 1
    return (draw * count).long().minimum(last).clamp_min(0)


def nth_true(mask: Tensor, draw: Tensor) -> Tensor:
    """(P, *shape) long: for each draw (P, *shape), a random True of `mask` (P, N), else 0."""
    order = torch.argsort((~mask).long(), dim=1, stable=True)
    at = pick(draw.reshape(len(mask), -1), mask.sum(1)[:, None])
    return order.gather(1, at).view(draw.shape)


def _mixed(x: Tensor) -> Tensor:
    """SplitMix64's finalizer."""
    x = (x ^ (x >> 30 & 2**34 - 1)) * FIRST
    x = (x ^ (x >> 27 & 2**37 - 1)) * SECOND
    return x ^ (x >> 31 & 2**33 - 1)
