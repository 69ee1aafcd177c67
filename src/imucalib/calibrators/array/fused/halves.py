"""Two halves of the chips against each other: whether what is stated of the noise holds.

Residuals of one sample are few, and heavy tails pull the motion after them, so that noise fitted to
residuals comes out too small. Halves of the chips share no noise: their difference is the check.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.fused.fuse import fuse
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.noise import ChipNoise
from imucalib.calibrators.array.fused.stretch import Stretch

_FEWEST = 6  # chips, so that each half shows the motion with some to spare
_SURE = 1.04  # factor from which the noise is widened
_MAD = 1.4826


def confirmed(
    instrument: Instrument,
    stretch: Stretch,
    noise: tuple[ChipNoise, ChipNoise],
    age: Array | None,
) -> tuple[ChipNoise, ChipNoise]:
    """The noise, the accelerometers' growth widened by what halves differ beyond what is stated.

    stretch : moving samples; age : (T, K) as in `fuse`
    """
    there = np.isfinite(stretch.acceleration).all(axis=2).mean(axis=0) > 0.5
    if there.sum() < _FEWEST:
        return noise
    number = np.arange(len(there))
    splits = (number % 2 == 0, (number // 2 + number) % 2 == 0)
    factor = float(np.mean([_apart(instrument, stretch, noise, age, half) for half in splits]))
    if not factor > _SURE:
        return noise
    return replace(noise[0], growth=noise[0].growth * factor), noise[1]


def _apart(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise],
    age: Array | None, half: Flags,
) -> float:  # fmt: skip
    """How much more force and dω/dt of the halves differ than stated, by their median."""
    found = []
    for chips in (half, ~half):
        acceleration = np.where(chips[:, None], stretch.acceleration, np.nan)
        rate = np.where(chips[:, None], stretch.rate, np.nan)
        part = Stretch(stretch.t, acceleration, rate)
        found.append(fuse(instrument, part, noise, age, tied=False))
    one, two = (f.motion for f in found)
    seen = ~(found[0].alone | found[1].alone)
    doubt = np.einsum("tii->ti", one.covariance + two.covariance)[seen, :6]
    off = np.concatenate([one.force - two.force, one.spin - two.spin], axis=1)[seen]
    return _MAD * float(np.median(np.abs(off) / np.sqrt(doubt)))
