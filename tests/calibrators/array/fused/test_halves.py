"""Halves of the chips against each other, with the motion of each half by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.fused import halves
from imucalib.calibrators.array.fused.halves import confirmed
from imucalib.calibrators.array.fused.noise import ChipNoise
from imucalib.calibrators.array.fused.stretch import Stretch

T = 4000


def widened(
    monkeypatch: pytest.MonkeyPatch, chips: int, factor: float, missing: int = 0
) -> tuple[float, list[list[int]]]:
    """How much the growth is widened where halves differ by `factor` of what is stated, and which
    chips were fused."""
    rng = np.random.default_rng(3)
    seen: list[list[int]] = []

    def fuse(_: object, part: Stretch, *__: object, tied: bool) -> SimpleNamespace:
        assert not tied
        seen.append(np.flatnonzero(np.isfinite(part.rate).all(axis=(0, 2))).tolist())
        sd = np.arange(1.0, 10.0) * (1.0 + len(seen) % 2)
        draws = factor * sd * rng.standard_normal((T, 9))
        draws[:100] += 1e6  # where one chip is alone
        covariance = np.broadcast_to(np.diag(sd**2), (T, 9, 9))
        motion = SimpleNamespace(covariance=covariance, force=draws[:, :3], spin=draws[:, 3:6])
        return SimpleNamespace(motion=motion, alone=np.arange(T) < 100)

    monkeypatch.setattr(halves, "fuse", fuse)
    whole = np.ones((T, chips, 3))
    whole[:, :missing] = np.nan
    noise = ChipNoise(np.ones((chips, 3)), np.full(chips, 2.0), 6.0)
    made = confirmed(None, Stretch(np.arange(float(T)), whole, np.ones((T, chips, 3))),  # type: ignore[arg-type]
                     (noise, noise), None)  # fmt: skip
    assert made[1] is noise
    np.testing.assert_array_equal(made[0].rest, noise.rest)
    return float(made[0].growth[0] / 2.0), seen


def test_noise_is_widened_by_what_halves_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    for factor in (1.1, 1.5):
        found, seen = widened(monkeypatch, 8, factor)
        assert found == pytest.approx(factor, rel=0.02)
        assert seen == [[0, 2, 4, 6], [1, 3, 5, 7], [0, 3, 4, 7], [1, 2, 5, 6]]


def test_less_than_four_percent_and_less_than_six_chips_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert widened(monkeypatch, 8, 1.0)[0] == 1.0
    assert widened(monkeypatch, 8, 0.5)[0] == 1.0
    assert widened(monkeypatch, 6, 1.5)[0] > 1.4
    assert widened(monkeypatch, 5, 1.5) == (1.0, [])
    assert widened(monkeypatch, 8, 1.5, missing=3) == (1.0, [])
    assert widened(monkeypatch, 8, 1.5, missing=2)[0] > 1.4
