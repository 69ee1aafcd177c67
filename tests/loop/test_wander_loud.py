"""A while in which runs scatter by another size, on residuals that are made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.loop.wander.left.loud import in_words, stretch_of

HOUR, ROWS = 3600.0, 300
TIME = 0.2 * HOUR * np.arange(ROWS)


@pytest.mark.parametrize("times", [5.0, 20.0, 0.2])
def test_a_while_is_found_with_its_size(times: float) -> None:
    left = np.random.default_rng(1).standard_normal(ROWS)
    left[100:150] *= times
    found = stretch_of(left, np.ones(ROWS))
    assert found is not None
    assert found.rows.start == pytest.approx(100, abs=6)
    assert found.rows.stop == pytest.approx(150, abs=6)
    assert found.times == pytest.approx(times, rel=0.35)
    assert found.nats > 10.0
    assert found.factor[120] == pytest.approx(found.times**2)
    assert found.factor[0] == 1.0


def test_a_loud_while_is_told_and_a_quiet_one_is_not() -> None:
    left = np.random.default_rng(1).standard_normal(ROWS)
    left[100:150] *= 20.0
    (one,) = in_words(stretch_of(left, np.ones(ROWS)), TIME)  # type: ignore[arg-type]
    words = one.name.split()
    assert one.name.startswith("noise of a run, some 20 times that of the others for ")
    assert float(words[words.index("for") + 1]) == pytest.approx(10.0, abs=2.5)
    assert float(words[words.index("after") - 2]) == pytest.approx(20.0, abs=2.5)
    assert (one.driver, one.kind) == ("time", "stretch")
    left[100:150] /= 400.0
    assert in_words(stretch_of(left, np.ones(ROWS)), TIME) == ()  # type: ignore[arg-type]


@pytest.mark.parametrize("tails", [0.0, 3.0])
def test_one_size_is_no_while(tails: float) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        left = rng.standard_t(tails, ROWS) if tails else rng.standard_normal(ROWS)
        found = stretch_of(left, np.ones(ROWS))
        assert found is not None
        assert in_words(found, TIME) == ()


def test_known_variances_are_no_while() -> None:
    variance = np.where(np.arange(ROWS) < 200, 1.0, 25.0)
    left = np.sqrt(variance) * np.random.default_rng(2).standard_normal(ROWS)
    found = stretch_of(left, variance)
    assert found is not None
    assert found.nats < 5.0
    assert stretch_of(left[:20], variance[:20]) is None
