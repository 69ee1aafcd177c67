"""`imucal imu`: the accelerometer by the size of gravity, then both sensors by the turns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.apply import apply_to_recording
from imucalib.calibrators.imu.axes import demand_axes
from imucalib.calibrators.imu.log import Imu, gyroscope_of, imu_of
from imucalib.calibrators.imu.search import (
    AskedTurns,
    Searched,
    declared_terms,
    gyro_effects,
    in_fold,
    joint_fit,
    searched,
)
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.files import still_rests, table_of_rests
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.calibrators.lab.sessions.joined_tables import joined
from imucalib.core.effect import Effect
from imucalib.effects import own_effects
from imucalib.estimators.turns import TurnFit, carried_error
from imucalib.inspection.noise import SensorNoise, noise_at_rest
from imucalib.loop.held_out import Difference, difference
from imucalib.recording.mapping import UNCHANGED, AxisMap, FieldMapping
from imucalib.recording.recording import Recording
from imucalib.rests.segments import Segments
from imucalib.rests.stillness import StillSettings
from imucalib.units import DEG, STANDARD_GRAVITY

#: Blocks of turns that are held out.
FOLDS = 5


@dataclass(frozen=True)
class ImuRequest:
    """What the user chose. gyro_axes : columns of the recording's rate that are the gyroscope's x,
    y, z; still : what counts as a rest; the rest as in `LabRequest`"""

    gravity: float = STANDARD_GRAVITY
    gravity_source: str = "standard gravity (give --gravity or --latitude for the local value)"
    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    loop: bool = True
    curves: bool = True
    extra_effects: Mapping[str, Effect] = field(default_factory=dict)
    gyro_axes: AxisMap = UNCHANGED
    still: StillSettings = field(default_factory=StillSettings)
    limits: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    command: str = ""

    def stated(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "declare": list(self.declare),
            "only": list(self.only),
            "without": list(self.without),
            "own_effects": own_effects(self.extra_effects),
            "loop": self.loop,
            "curves": self.curves,
            "gravity_m_per_s2": self.gravity,
            "gravity_source": self.gravity_source,
            "gyro_axes": [list(self.gyro_axes.order), list(self.gyro_axes.sign)],
            "shortest_rest_s": self.still.shortest,
            "limits": dict(self.limits),
        }

    @property
    def of_turns(self) -> AskedTurns:
        """What the search over turns is asked."""
        own = gyro_effects(AskedTurns(own=self.extra_effects))
        return AskedTurns(
            declare=tuple(n for n in self.declare if n in own),
            only=self.only,
            without=self.without,
            own=self.extra_effects,
            loop=self.loop,
        )

    @property
    def of_rests(self) -> LabRequest:
        """What the accelerometer's calibration is asked."""
        gyro = gyro_effects(AskedTurns(own=self.extra_effects))
        settings = LabSettings(
            declare=tuple(n for n in self.declare if n not in gyro),
            only=self.only,
            without=self.without,
            loop=self.loop,
            curves=self.curves,
            extra_effects=self.extra_effects,
            partial=True,
        )
        return LabRequest(
            gravity=self.gravity,
            gravity_source=self.gravity_source,
            reference="norm",
            still=self.still,
            settings=settings,
            seed=self.seed,
            command=self.command,
        )


@dataclass(frozen=True)
class HeldOutTurns:
    """(T,) deg, what gravity is off after a turn that took no part: as read, by the base model and
    by the final one; and what the search gains"""

    raw: Array
    base: Array
    final: Array
    gained: Difference


@dataclass(frozen=True)
class ImuResult:
    """accelerometer : by the rests; imu : the log; noise : of the longest rest
    found : the search; fit : what is corrected;
    fitted : (3,) deg rms of the turns that were fitted, as in `HeldOutTurns`
    refused : whether held-out turns refuse what was told"""

    recordings: tuple[Recording, ...]
    accelerometer: LabRun
    imu: Imu
    noise: tuple[SensorNoise, ...]
    found: Searched
    fit: TurnFit
    fitted: tuple[float, float, float]
    held_out: HeldOutTurns
    refused: bool


def calibrate_imu(
    paths: Sequence[Path],
    mapping: FieldMapping,
    request: ImuRequest,
    say: Callable[[str], None],
) -> ImuResult:
    """Read, check and calibrate one IMU's logs.

    Raises as `readers.read`, `imu_of` and `run_lab`; UnreadableInput where the gyroscope's axes are
    not the accelerometer's.
    """
    read = [still_rests(path, mapping, request.still, say) for path in paths]
    recordings = [_in_axes(recording, request) for recording, _ in read]
    segments = [found for _, found in read]
    for recording, found in zip(recordings, segments, strict=True):
        gyroscope_of(recording, found.triads[0])
    # An hour of samples is not held once more than it has to be.
    plain = imu_of(recordings, segments, request.gravity).turns
    demand_axes(plain, str(paths[0]), _matrix(request.gyro_axes))
    del plain, read
    accelerometer = _accelerometer(recordings, segments, request)
    triads = [found.triads[0] for found in segments]
    # The mark that a correction leaves is not kept: a check sum of its own is not made for it.
    first = replace(accelerometer.calibration, sha256=accelerometer.table.sha256)
    corrected = [
        apply_to_recording(first, recording, triad, again=True)
        for recording, triad in zip(recordings, triads, strict=True)
    ]
    imu = imu_of(corrected, segments, request.gravity)
    say(f"{len(imu.turns.turns)} turns between rests; {len(imu.left_out)} left out")
    result = _result(tuple(recordings), accelerometer, imu, request)
    pairs = zip(recordings, segments, strict=True)
    longest, still = max(pairs, key=lambda pair: float(np.max(pair[1].stop - pair[1].start)))
    return replace(result, noise=noise_at_rest((longest,), still))


def _result(
    recordings: tuple[Recording, ...], accelerometer: LabRun, imu: Imu, request: ImuRequest
) -> ImuResult:
    asked = request.of_turns
    base = joint_fit(imu.turns, declared_terms(asked), imu.course)
    found = searched(base, imu.course, asked)
    held = _held_out(found, imu, asked)
    refused = bool(found.said.places) and not held.gained.holds
    every = np.arange(len(imu.turns.turns))
    fits = (_as_read(base), base, found.final)
    raw, before, after = (_rms(carried_error(fit, every) / DEG) for fit in fits)
    if refused:
        held, after = replace(held, final=held.base), before
    return ImuResult(
        recordings=recordings,
        accelerometer=accelerometer,
        imu=imu,
        noise=(),
        found=found,
        fit=base if refused else found.final,
        fitted=(raw, before, after),
        held_out=held,
        refused=refused,
    )


def _in_axes(recording: Recording, request: ImuRequest) -> Recording:
    """The recording with its rates in the axes that were stated."""
    if request.gyro_axes == UNCHANGED:
        return recording
    channels = {
        name: replace(c, values=request.gyro_axes.apply(c.values))
        if c.quantity == "angular_rate"
        else c
        for name, c in recording.channels.items()
    }
    return replace(recording, channels=channels)


def _matrix(axes: AxisMap) -> Array:
    return np.asarray(np.eye(3)[list(axes.order)] * np.array(axes.sign)[:, None])


def _accelerometer(
    recordings: Sequence[Recording], segments: Sequence[Segments], request: ImuRequest
) -> LabRun:
    tables = [table_of_rests(s, r) for r, s in zip(recordings, segments, strict=True)]
    table, joining = joined(tables)
    notes = tuple(dict.fromkeys(n for r in recordings for n in r.notes))
    return run_lab(
        table,
        request.of_rests,
        mapping=recordings[0].mapping,
        gaps=sum(len(r.gaps) for r in recordings),
        notes=(*notes, *joining),
    )


def _held_out(found: Searched, imu: Imu, asked: AskedTurns) -> HeldOutTurns:
    """Blocks of turns in turn, everything chosen without them."""
    count = len(imu.turns.turns)
    folds = min(FOLDS, count)
    part = np.arange(count) * folds // count
    errors = np.zeros((3, count))
    for k in range(folds):
        out = part == k
        base, final = in_fold(found, out, imu.course, asked)
        for row, fit in enumerate((_as_read(base), base, final)):
            errors[row, out] = carried_error(fit, np.flatnonzero(out)) / DEG
    gained = difference(errors[1], errors[2], np.arange(count), folds, "rms")
    return HeldOutTurns(errors[0], errors[1], errors[2], gained)


def _as_read(fit: TurnFit) -> TurnFit:
    """Rates with the bias of the rests taken off, and no gains."""
    state = replace(
        fit.state, gain=np.eye(3), theta=np.zeros_like(fit.state.theta), drift=fit.log.rate
    )
    return replace(fit, state=state)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
