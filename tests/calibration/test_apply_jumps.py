"""A thermometer's jumps in what is corrected: no temperature there, and said so."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration import apply as application
from imucalib.calibration.apply import apply_to_recording, correct_file
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibrators.actigraph.observations import NINE
from imucalib.calibrators.actigraph.simulation import SENSOR
from imucalib.core.effect import Context
from imucalib.effects import named
from imucalib.readers import blocks, read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.thermal import is_gone, thermal_history
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
G = STANDARD_GRAVITY
T = np.arange(6000.0)
WARM = 30.0 + 2.0 * np.sin(T / 1500.0)
PER_DEGREE = np.array([1.5, -2.0, 1.0])


def calibration(effect: str = "temperature_bias", covariate: str = "temperature") -> Calibration:
    context = Context(2, {covariate: np.array([20.0, 30.0])})
    values = [(name, SENSOR[name]) for name in NINE] + [(effect, PER_DEGREE)]
    stored = tuple(
        StoredParameter(p.name, name, "sensor", float(v), 0.1, p.unit)
        for name, size in values
        for p, v in zip(named(name).parameters(context), size, strict=True)
    )
    return Calibration(
        calibrator="actigraph", raw_unit="m/s2", raw_to_si=1.0, gravity=G, status="ok", reasons=(),
        parameters=stored, covariance=1e-6 * np.eye(len(stored)), facts={},
        valid={covariate: (26.9, 33.3)},
    )  # fmt: skip


def recording(warm: Array, t: Array = T) -> Recording:
    force = G * np.tile([0.0, 0.6, 0.8], (T.size, 1))
    channels = {
        "imu0/acceleration": Channel(T, force, "m/s2", "acceleration", "imu0", 1.0),
        "imu0/temperature": Channel(
            t, warm[:, None], "degC", "temperature", "imu0", 1.0 / float(np.median(np.diff(t)))
        ),
    }
    return Recording(channels, "made", "made", "", start_ns=0)


def corrected(found: Recording) -> Array:
    return np.asarray(found.channels["imu0/acceleration"].values)


@pytest.mark.parametrize("value", [85.0, -127.0])
def test_a_jump_is_no_temperature(value: float) -> None:
    """Its samples are corrected as without a thermometer, and counted; all others are not touched
    by it."""
    at = np.array([0, 700, 701, 3000, 5999])
    wild = WARM.copy()
    wild[at] = value
    known = calibration()
    sound = apply_to_recording(known, recording(WARM))
    found = apply_to_recording(known, recording(wild))
    without = recording(WARM)
    del without.channels["imu0/temperature"]  # type: ignore[attr-defined]
    bare = corrected(apply_to_recording(known, without))
    gone = np.any(corrected(found) != corrected(sound), axis=1)
    assert gone[at].all()
    assert gone.sum() <= 10 * (at.size - 1)
    assert np.allclose(corrected(found)[gone], bare[gone], rtol=0.0, atol=1e-9)
    (note,) = [n for n in found.notes if "jumps" in n]
    assert note.startswith(f"{int(gone.sum())} of 6000 samples have no temperature")
    assert not any("outside" in n or "jumps" in n for n in sound.notes)
    assert not any("outside" in n for n in found.notes)


def test_a_slow_thermometer_tells_nothing_beside_a_jump(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the last reading before to the first one after, in blocks of any size."""
    slow = WARM[::30].copy()
    slow[100] = 85.0
    path = tmp_path / "slow.h5"
    whole = recording(slow, T[::30])
    with h5py.File(path, "w") as file:
        force = whole.channels["imu0/acceleration"].values / G
        file.create_dataset("imu0/acceleration", data=force).attrs.update(unit="g", sample_rate=1.0)
        warm = file.create_dataset("imu0/temperature", data=slow)
        warm.attrs.update(unit="degC", sample_rate=1.0 / 30.0)
    known = calibration()
    expected = corrected(apply_to_recording(known, read(path)))
    middle = expected[T == 3000.0]
    alone = np.all(np.isclose(expected, middle, rtol=0.0, atol=1e-9), axis=1)
    assert T[alone].min() == 2971.0
    assert T[alone].max() == 3029.0
    assert np.ptp(expected[:, 0]) < 10.0 * MG
    for rows in (601, 2500):
        monkeypatch.setattr(
            application, "blocks", lambda *a, s=rows, **k: blocks(*a, block_samples=s, **k)
        )
        target = tmp_path / f"out{rows}.h5"
        notes = correct_file(known, path, target, FieldMapping())
        assert np.allclose(corrected(read(target)), expected, rtol=0.0, atol=1e-9)
        assert sum("59 of 6000 samples have no temperature" in note for note in notes) == 1


def test_a_thermometer_that_seldom_answers_is_as_none() -> None:
    wild = WARM.copy()
    wild[np.random.default_rng(1).random(T.size) < 0.8] = -127.0
    history = thermal_history([recording(wild)], "imu0")
    assert history is not None
    assert is_gone(history.gone, T).all()
    for known in (calibration(), calibration("thermal_lag@1h", "temperature_lag_1h")):
        found = apply_to_recording(known, recording(wild))
        without = recording(WARM)
        del without.channels["imu0/temperature"]  # type: ignore[attr-defined]
        bare = apply_to_recording(known, without)
        assert np.allclose(corrected(found), corrected(bare), rtol=0.0, atol=1e-9)
