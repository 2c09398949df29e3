"""Random numbers by counting: the streams never change silently, and they are as random as they need to be."""

import zlib
from typing import Any

import numpy as np
import pytest

from dcgrid_env.core import random

MASK = 2**64 - 1
GAMMA = 0x9E3779B97F4A7C15
STREAMS = (
    random.PLACEMENT, random.TRACE_ROW, random.TRACE_START, random.LOAD, random.MEASUREMENT, random.CORRELATION
)  # fmt: skip

# Of the keys of seeds 0, 1, 2^64 - 1 and episodes 0, 0, 7 in the training split.
SEEDS, EPISODES = (0, 1, MASK), (0, 0, 7)
GOLDEN_KEYS = [0x43E76727BD6CCC86, 0xBA0255C92FE69482, 0x1D3E721B198A1B28]
GOLDEN_BITS = [
    [0x15AC70C9FF6EAD02, 0xC4062D67BCC5D9E0, 0x89B8CF471ED9D6D8],
    [0xF75E04E11AC2A214, 0x4706F874CCFD0628, 0x65FA4F34851E41FB],
    [0x0C340D062C03ADBF, 0x945055A305F4128F, 0x6634FD7788551174],
]
GOLDEN_STANDARD = [
    [0.12855064588921786, 0.7520371358506772, -1.9063236200635865],
    [-0.3150600842198532, -0.080767017647502, -0.6783795186440058],
    [0.4995609187084696, -1.7913839081038396, -0.7669430906782921],
]
STEPS = (0, 1, 100_000)


def mix(x: int) -> int:
    """SplitMix64's output function once more, in whole numbers without a size."""
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & MASK
    return x ^ (x >> 31)


def hashed(key: int, stream: int, step: int, index: int) -> int:
    count = (stream << 56) | (step << 24) | index
    return mix((mix((key + GAMMA) & MASK) + (count + 1) * GAMMA) & MASK)


def standardised(h: int) -> float:
    """Four uniforms on 0 .. 65535, summed, less the mean, over the standard deviation."""
    total = sum((h >> shift) & 0xFFFF for shift in (0, 16, 32, 48))
    return (total - 2 * 65535) / np.sqrt(4 * (65536**2 - 1) / 12)


def keys_of(split: bytes, seeds: Any, episodes: Any) -> np.ndarray:
    return random.keys(np.uint64(zlib.crc32(split)), np.array(seeds, np.uint64), np.array(episodes, np.uint64))


def row_keys(n: int) -> np.ndarray:
    return keys_of(b"test", np.arange(n), np.zeros(n))


def draws(n_row: int, n: int, stream: int = random.LOAD, step: int = 1) -> np.ndarray:
    return random.standard(row_keys(n_row), stream, np.full(n_row, step), n)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_golden_figures():
    assert STREAMS == (1, 2, 3, 4, 5, 6)  # part of every episode ever drawn
    keys = keys_of(b"train", SEEDS, EPISODES)
    assert keys.dtype == np.uint64
    assert keys.tolist() == GOLDEN_KEYS
    bits = random.bits(keys, random.TRACE_ROW, 3)
    assert bits.dtype == np.uint64
    assert bits.tolist() == GOLDEN_BITS
    assert random.standard(keys, random.MEASUREMENT, np.array(STEPS), 3).tolist() == GOLDEN_STANDARD  # to the bit


def test_hash_is_splitmix64():
    # The published generator's first outputs for the seed 1234567.
    outputs = [mix((1234567 + k * GAMMA) & MASK) for k in (1, 2, 3)]
    assert outputs == [6457827717110365317, 3203168211198807973, 9817491932198370423]
    base = mix((zlib.crc32(b"train") + GAMMA) & MASK)
    keys = [
        mix((mix((base + seed * GAMMA) & MASK) + (number + 1) * GAMMA) & MASK)
        for seed, number in zip(SEEDS, EPISODES, strict=True)
    ]
    assert keys == GOLDEN_KEYS
    assert [[hashed(key, random.TRACE_ROW, 0, j) for j in range(3)] for key in keys] == GOLDEN_BITS
    for key, step, wanted in zip(keys, STEPS, GOLDEN_STANDARD, strict=True):
        drawn = [standardised(hashed(key, random.MEASUREMENT, step, j)) for j in range(3)]
        assert drawn == pytest.approx(wanted, rel=1e-12, abs=1e-12)


def test_standard_has_the_moments_it_says():
    z = draws(1000, 400)
    n = z.size
    assert abs(z.mean()) < 5 / np.sqrt(n)
    assert z.var() == pytest.approx(1.0, abs=5 * np.sqrt(1.7 / n))  # variance of z^2 is kurtosis 2.7 less 1
    assert (z**3).mean() == pytest.approx(0.0, abs=0.015)
    assert (z**4).mean() - 3.0 == pytest.approx(-0.3, abs=0.03)
    assert np.abs(z).max() < 3.47
    assert np.abs(z).max() > 3.0
    # The sum of four uniforms, at some points: P(z < -2), P(z < -1), P(z < 0) of the cubic spline.
    for at in (-2.0, -1.0, 0.0, 1.5):
        x = 2.0 + at / np.sqrt(3.0)
        wanted = sum((-1) ** k * (1, 4, 6, 4, 1)[k] * max(x - k, 0.0) ** 4 for k in range(5)) / 24.0
        assert (z < at).mean() == pytest.approx(wanted, abs=4e-3)


def test_no_draw_is_ever_beyond_the_bound():
    # The largest and the smallest hash there can be.
    assert standardised(MASK) < 3.47
    assert standardised(0) > -3.47
    assert standardised(MASK) == pytest.approx(-standardised(0))


@pytest.mark.parametrize("lag", [1, 2, 7])
def test_rows_indices_and_steps_are_independent(lag):
    z = draws(600, 300)
    bound = 5 / np.sqrt(z.size - 300 * lag)
    assert abs(correlation(z[lag:], z[:-lag])) < bound
    assert abs(correlation(z[:, lag:], z[:, :-lag])) < bound
    assert abs(correlation(z, draws(600, 300, step=1 + lag))) < bound
    # And their squares, which a shared magnitude would show in.
    assert abs(correlation(z[lag:] ** 2, z[:-lag] ** 2)) < bound
    assert abs(correlation(z**2, draws(600, 300, step=1 + lag) ** 2)) < bound


def test_streams_are_independent():
    z = [draws(400, 200, stream=stream) for stream in STREAMS]
    for i in range(len(z)):
        for j in range(i):
            assert (z[i] == z[j]).mean() < 1e-4  # the sum of four 16-bit figures has 262,141 values
            assert abs(correlation(z[i], z[j])) < 5 / np.sqrt(z[i].size)


def test_keys_depend_on_split_seed_and_episode_and_do_not_collide():
    seeds, episodes = (grid.ravel() for grid in np.meshgrid(np.arange(200), np.arange(200)))
    every = np.concatenate([keys_of(split, seeds, episodes) for split in (b"train", b"validation", b"test")])
    assert len(np.unique(every)) == 3 * 200 * 200


def test_seeds_and_episodes_are_not_interchanged():
    # Seed 0's second episode is not seed 1's first, nor the like further on.
    assert (
        keys_of(b"train", [0, 1, 2, 3], [3, 2, 1, 0]).tolist() != keys_of(b"train", [3, 2, 1, 0], [0, 1, 2, 3]).tolist()
    )
    assert keys_of(b"train", [0], [1])[0] != keys_of(b"train", [1], [0])[0]


def test_bits_are_even():
    bits = random.bits(row_keys(3000), random.TRACE_START, 7)
    for modulus in (2, 3, 7, 80, 3479):
        share = np.bincount((bits % np.uint64(modulus)).ravel().astype(int), minlength=modulus) / bits.size
        assert np.abs(share - 1 / modulus).max() < 6 * np.sqrt(1 / modulus / bits.size)
    for bit in range(64):
        assert ((bits >> np.uint64(bit)) & np.uint64(1)).mean() == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(bits.size))


def test_a_row_does_not_depend_on_its_company():
    keys, steps = row_keys(10), np.arange(10)
    together = random.standard(keys, random.LOAD, steps, 4)
    for i in range(10):
        alone = random.standard(keys[i : i + 1], random.LOAD, steps[i : i + 1], 4)
        assert alone.tolist() == together[i : i + 1].tolist()
    # Nor a draw on how many there are.
    assert random.standard(keys, random.LOAD, steps, 2).tolist() == together[:, :2].tolist()


def load_steps(keys: np.ndarray, first: np.ndarray, count: int, rho: float, n_bus: int = 5, **kw: Any) -> np.ndarray:
    """Compute (count, row, bus) of the noise process from step ``first`` on, starting at ``z``."""
    base = np.ones(n_bus)
    z = kw.get("z", np.zeros((len(keys), n_bus)))
    course = []
    for k in range(count):
        out = np.empty((3, len(keys), n_bus))
        random.load_step(
            keys, first + k, z, np.ones(len(keys)), rho, 0.05, base, base, 0 * base, out[0], out[1], out[2]
        )
        z = out[0]
        course.append(z)
    return np.array(course)


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.99])
def test_load_noise_is_stationary_with_the_correlation_asked_for(rho):
    z = load_steps(row_keys(2000), np.zeros(2000, np.int64), 60, rho, n_bus=10)
    per_step = z.var(axis=(1, 2))
    # From the first step on: the process does not have to warm up.
    np.testing.assert_allclose(per_step, 1.0, atol=0.06)
    for lag in (1, 3):
        assert correlation(z[lag:], z[:-lag]) == pytest.approx(rho**lag, abs=0.01)
    assert abs(correlation(z[:, :, 1:], z[:, :, :-1])) < 0.02  # each bus has its own
    assert abs(correlation(z[:, 1:], z[:, :-1])) < 0.02


def test_load_noise_worked_by_hand():
    keys, rho, sigma = row_keys(2), 0.8, 0.1
    steps = np.array([0, 7])
    z = np.array([[9.0, 9.0, 9.0], [0.5, -1.0, 2.0]])
    p_base, q_base, q_fixed = np.array([0.0, 100.0, 40.0]), np.array([0.0, 50.0, -20.0]), np.array([0.0, 0.0, -30.0])
    z_out, p_out, q_out = np.empty((3, 2, 3))
    share = np.array([1.0, 0.6])
    assert random.load_step(keys, steps, z, share, rho, sigma, p_base, q_base, q_fixed, z_out, p_out, q_out) == 0
    e = random.standard(keys, random.LOAD, steps, 3)
    wanted = np.array([e[0], 0.8 * z[1] + 0.6 * e[1]])  # at step 0 what was before does not matter
    np.testing.assert_allclose(z_out, wanted, rtol=1e-14)
    # One draw for p and q together; capacitors neither are noisy nor follow the day.
    course = share[:, None]
    np.testing.assert_allclose(p_out, course * p_base * (1 + 0.1 * wanted), rtol=1e-14)
    np.testing.assert_allclose(q_out, course * q_base * (1 + 0.1 * wanted) + q_fixed, rtol=1e-14)


def test_load_noise_has_the_same_bits_when_rows_are_split():
    keys, steps = row_keys(7), np.array([0, 0, 3, 4, 0, 9, 2])
    z = np.random.default_rng(0).standard_normal((7, 5))
    together = load_steps(keys, steps, 5, 0.9, z=z)
    for cut in (slice(0, 1), slice(1, 4), slice(4, 7)):
        apart = load_steps(keys[cut], steps[cut], 5, 0.9, z=z[cut])
        np.testing.assert_array_equal(apart, together[:, cut])
