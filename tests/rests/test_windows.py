"""Windows of a recording, and what decides a rest on windows by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import scan
from imucalib.rests.windows import WindowBuilder, window_statistics

KINDS = ("f4", "f8", "i2", "u1", "i4", "i8", "f2")


def drawn(seed: int, shape: tuple[int, int, int], kind: str, level: float) -> np.ndarray:
    numbers = np.random.default_rng(seed).normal(level, 20.0, shape)
    numbers[::3] = np.round(numbers[::3, :1])  # constant windows
    return numbers.clip(0, 250).astype(kind)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    m=st.integers(1, 40),
    w=st.integers(1, 300),
    k=st.sampled_from((1, 3)),
    kind=st.sampled_from(KINDS),
    level=st.sampled_from((0.0, 100.0)),
    cache=st.sampled_from((1, 4096, 1 << 19)),
)
def test_equal_to_naive(
    seed: int, m: int, w: int, k: int, kind: str, level: float, cache: int
) -> None:
    cube = drawn(seed, (m, w, k), kind, level)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("imucalib.rests.windows._CACHE", cache)
        patch.setattr("imucalib.rests.windows._EVERY", 1)
        mean, variance, low, high, finest = window_statistics(cube)
    exact = cube.astype(np.float64)
    assert np.array_equal(low, exact.min(axis=1))
    assert np.array_equal(high, exact.max(axis=1))
    single = np.result_type(cube.dtype, np.float32) == np.float32
    error = 3e-7 if single else 1e-13
    reach = np.abs(exact - exact[:, :1]).max(axis=1)
    assert np.all(np.abs(mean - exact.mean(axis=1)) <= error * reach + 1e-14 * np.abs(mean))
    naive = exact.var(axis=1, ddof=1) if w > 1 else np.zeros((m, k))
    assert np.all(np.abs(variance - naive) <= 10.0 * error * reach**2)
    assert np.all(variance[high == low] == 0.0)
    steps = np.abs(np.diff(exact, axis=1))
    smallest = np.where(steps > 0, steps, np.inf).min(axis=(0, 1), initial=np.inf)
    assert np.allclose(finest, smallest, rtol=1e-6)


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_variance_far_from_zero(kind: str) -> None:
    """Noise of one part in ten thousand keeps its digits beside a large offset."""
    rng = np.random.default_rng(4)
    cube = (1e3 + 0.1 * rng.standard_normal((20, 1000, 3))).astype(kind)
    _, variance, *_ = window_statistics(cube)
    exact = cube.astype(np.float64).var(axis=1, ddof=1)
    assert np.allclose(variance, exact, rtol=1e-5 if kind == "f4" else 1e-10)


def test_windows_of_blocks_are_those_of_the_whole() -> None:
    rng = np.random.default_rng(1)
    values, builder = rng.standard_normal((480, 3)), WindowBuilder(10)
    for a, b in pairwise([0, 3, 40, 44, 47, 160, 475, 480]):
        t = np.arange(a, b) / 10.0
        builder.add(Channel(t, values[a:b], "m/s2", "acceleration", "imu0", 10.0), [])
    found = builder.windows()
    assert found is not None
    np.testing.assert_allclose(found.mean, values.reshape(-1, 10, 3).mean(axis=1), atol=1e-14)
    assert np.array_equal(found.first, 10 * np.arange(48))
    assert np.array_equal(found.start, np.arange(48.0))


def test_a_scan_tells_what_was_recorded() -> None:
    """Samples, the rate and the time of the last one, over blocks."""
    rng = np.random.default_rng(2)
    t = np.arange(5000) / 50.0
    values = rng.normal([0.0, 0.0, 9.8], 0.02, (5000, 3))
    blocks_of = [
        Recording(
            {"w/acceleration": Channel(t[part], values[part], "m/s2", "acceleration", "w", 50.0)},
            "made", "made", "",
        )
        for part in (slice(0, 3000), slice(3000, 4999))
    ]  # fmt: skip
    found = scan(blocks_of, 10.0)
    assert (found.samples, found.rate, found.stop) == (4999, 50.0, t[4998])
    assert (found.triad, len(found.windows.mean), found.gaps) == ("w", 9, 0)
