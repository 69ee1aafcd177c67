"""A damaged calibration.yaml: what `apply`, `export` and `validate` take from it."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from imucalib.calibration import file
from imucalib.calibration.calibration import Calibration
from worlds.fuzz.damage import damaged
from worlds.stated import stated

NAME = "calibration.yaml"


@cache
def _whole() -> tuple[bytes, Calibration]:
    rng = np.random.default_rng(3)
    values = {"bias": rng.normal(scale=30.0, size=3), "scale": rng.normal(scale=0.01, size=3)}
    covariance = np.diag([0.36] * 3 + [4e-8] * 3)
    calibration = stated(values, covariance, gravity=9.81, facts={"noise": {"reading_mg": 1.25}})
    return file.to_yaml(calibration).encode(), calibration


def put(path: Path, rng: random.Random) -> str:
    """Write a damaged calibration and say what was done to it."""
    data, _ = _whole()
    edges = [0, *(k + 1 for k, byte in enumerate(data) if byte == 10)]
    broken, done = damaged(data, rng, edges)
    path.write_bytes(broken)
    return done


def different(path: Path) -> list[str]:
    """The blocks that change a corrected number or its uncertainty, and are taken nevertheless."""
    found, (_, whole) = file.read(path), _whole()
    file.check(found, str(path))
    read, want = (file.as_dict(replace(c, facts={}, reasons=(), sha256="")) for c in (found, whole))
    return [key for key in want if read[key] != want[key] and key not in ("status", "calibrator")]
