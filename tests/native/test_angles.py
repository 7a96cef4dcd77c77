"""Sines, angles and sums of vectors beside those of mpmath and numpy, for each kind of CPU."""

import ctypes
import subprocess
from pathlib import Path

import mpmath
import numpy as np
import pytest
import torch

from cgtorch.native import VECTOR, compiler

SOURCE = """
#include "angles.h"
#include "svm/rbf.h"
void sines(const real *x, real *s, real *c, int64_t n) {
  for (int64_t i = 0; i < n; i += WIDTH) {
    vec sine, cosine;
    sine_cosine(load(x + i), &sine, &cosine);
    store(s + i, sine);
    store(c + i, cosine);
  }
}
void angles(const real *y, const real *x, real *out, int64_t n) {
  for (int64_t i = 0; i < n; i += WIDTH) store(out + i, atan2_vec(load(y + i), load(x + i)));
}
void machine(const real *x, const real *centres, const real *weights, real *values, real *nearest,
             int64_t m) {
  real bias = 0;
  Machine f = {centres, weights, &bias, 1, m, 1, 1};
  machine_rows(&f, x, TILE, 1, 1, values, nearest);
}
"""
TYPES = {"float": np.float32, "double": np.float64}
COUNT = 1024


def targets():
    """Those of a wheel that this CPU can run, and its own."""
    able = torch.backends.cpu.get_cpu_capability()
    known = list(compiler.TARGETS)
    runs = known[known.index(able) :] if able in known else []
    return {"own": compiler.own_target("cc"), **{name: compiler.TARGETS[name] for name in runs}}


@pytest.fixture(scope="module", params=TYPES)
def real(request):
    return request.param


class Functions:
    """The functions of `SOURCE` for numbers of a type."""

    def __init__(self, folder: Path, real: str, name: str):
        source, library = folder / "angles.c", folder / f"{real}-{name}.so"
        source.write_text(SOURCE)
        command = [*compiler._command("cc", real, targets()[name]), f"-I{compiler.SOURCES}"]
        rest = ["-Wno-psabi", "-shared", str(source), "-o", str(library), "-lm"]
        subprocess.run([*command, *rest], check=True)
        self.library = ctypes.CDLL(str(library))

    def called(self, name, *arrays):
        places = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        getattr(self.library, name)(*places, ctypes.c_int64(len(arrays[0])))

    def sines(self, x):
        sine, cosine = np.empty((2, len(x)), x.dtype)
        self.called("sines", x, sine, cosine)
        return sine, cosine

    def angles(self, y, x):
        out = np.empty_like(x)
        self.called("angles", y, x, out)
        return out

    def machine(self, x, centres, weights):
        """Values of rows x (4,) and squared distances (4,) to centres (m,)."""
        found = np.empty((2, 4), x.dtype)
        places = [ctypes.c_void_p(each.ctypes.data) for each in (x, centres, weights, *found)]
        self.library.machine(*places, ctypes.c_int64(len(centres)))
        return found


@pytest.fixture(scope="module")
def functions(tmp_path_factory, real):
    return Functions(tmp_path_factory.mktemp("angles"), real, "own")


def spread(real, low, high):
    """Numbers of both signs and of all sizes from 10^low to 10^high."""
    random = np.random.default_rng(0)
    size = 10 ** random.uniform(low, high, COUNT)
    return (size * random.choice([-1, 1], COUNT)).astype(TYPES[real])


def test_sines_are_those_of_exact_arithmetic_however_large_the_angle(real, functions):
    digits = np.finfo(TYPES[real]).eps
    with mpmath.workprec(1300):
        for most in (3, 38 if real == "float" else 307):
            x = spread(real, -3, most)
            sine, cosine = functions.sines(x)
            for found, exact in ((sine, mpmath.sin), (cosine, mpmath.cos)):
                wanted = np.array([float(exact(mpmath.mpf(float(each)))) for each in x])
                assert np.abs(found.astype(float) - wanted).max() < 1.1 * digits
                far = np.abs(wanted) > 1e-3
                assert np.abs(found.astype(float) / wanted - 1)[far].max() < 2.2 * digits


def test_angles_next_to_a_quarter_turn_keep_all_digits_of_what_is_left(real, functions):
    """The numbers of each type that are nearest to a multiple (Muller, Elementary Functions)."""
    nearest = 16367173 * 2.0**72 if real == "float" else 6381956970095103 * 2.0**797
    x = np.array([nearest, -nearest, nearest / 2, 2 * nearest] * 4, TYPES[real])
    with mpmath.workprec(1300):
        for found, exact in zip(functions.sines(x), (mpmath.sin, mpmath.cos), strict=True):
            wanted = np.array([float(exact(mpmath.mpf(float(each)))) for each in x])
            assert np.abs(found / wanted - 1).max() < 2.2 * np.finfo(TYPES[real]).eps
            assert np.abs(wanted[:2]).min() < 1e-8 or np.abs(wanted[:2]).min() > 0.99


def test_angles_are_those_of_numpy(real, functions):
    digits = np.finfo(TYPES[real]).eps
    y, x = spread(real, -6, 6), np.roll(spread(real, -6, 6), 1)
    wanted = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    assert np.abs(functions.angles(y, x) / wanted - 1).max() < 2 * digits


def test_angles_of_zeros_have_their_signs_and_what_is_not_finite_has_none(real, functions):
    kind = TYPES[real]
    y = np.array([0, -0.0, 0, -0.0, 1, -1, 0, np.nan, 1, np.inf, 1, 2] + [1] * 4, kind)
    x = np.array([1, 1, -1, -1, 0, 0, 0, 1, np.nan, 1, np.inf, 2] + [1] * 4, kind)
    found = functions.angles(y, x)
    np.testing.assert_allclose(found[:7], np.arctan2(y, x)[:7], rtol=1e-6)
    assert np.signbit(found[:2]).tolist() == [False, True]
    assert np.isnan(found[7:11]).all()
    assert np.isfinite(found[11:]).all()
    not_finite = np.array([np.nan, np.inf, -np.inf] + [0] * 13, kind)
    assert np.isnan(np.stack(functions.sines(not_finite))[:, :3]).all()


def test_sums_over_blocks_are_those_of_numpy(real, functions):
    x, centres, weights = machine_of(real)
    square = (x[:, None].astype(float) - centres) ** 2
    values, nearest = functions.machine(x, centres, weights)
    np.testing.assert_allclose(values, (2**-square * weights).sum(1), rtol=1e-4)
    np.testing.assert_allclose(nearest, square.min(1), rtol=1e-3)


def machine_of(real):
    """Four rows, and three blocks of centres and weights."""
    random = np.random.default_rng(1)
    centres, weights = random.normal(size=(2, 3 * block_of(real)))
    return [each.astype(TYPES[real]) for each in (random.normal(size=4), centres, 1 + weights**2)]


def block_of(real):
    return VECTOR // np.dtype(TYPES[real]).itemsize


def test_all_cpus_make_the_same_bits(real, tmp_path):
    x, y = spread(real, -3, 30), spread(real, -6, 6)
    found = []
    for name in targets():
        functions = Functions(tmp_path, real, name)
        angles = np.stack([*functions.sines(x), functions.angles(y, np.roll(y, 1))])
        found.append(np.concatenate([angles.ravel(), functions.machine(*machine_of(real)).ravel()]))
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)
