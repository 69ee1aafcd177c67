"""`imucal imu`: the accelerometer by the size of gravity, then both sensors by the turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.apply import apply_to_recording
from imucalib.calibrators.imu.log import ImuLog, gyroscope_of, imu_of
from imucalib.calibrators.imu.request import ImuRequest
from imucalib.calibrators.imu.search import (
    LawSearch,
    declared_terms,
    in_fold,
    joint_fit,
    search_laws,
)
from imucalib.calibrators.lab.errors import rms
from imucalib.calibrators.lab.files import run_of_rests, still_rests, table_of_rests
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.set_up import DOUBT, SIGNED, axes_in_words, misfits, weigh
from imucalib.errors import UnreadableInput
from imucalib.estimators.carried import attitudes
from imucalib.estimators.turn_log import TurnLog, moved_by
from imucalib.estimators.turns import TurnFit, carried_error
from imucalib.inspection.noise import SensorNoise, noise_at_rest
from imucalib.posterior.held_out import Difference, difference
from imucalib.recording.mapping import UNCHANGED, AxisMap, FieldMapping
from imucalib.recording.recording import Recording
from imucalib.units import DEG

#: Blocks of turns that are held out.
FOLDS = 5
_TURNS = 12  # that are carried


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
    refused : whether held-out turns refuse what the search found"""

    recordings: tuple[Recording, ...]
    accelerometer: LabRun
    imu: ImuLog
    noise: tuple[SensorNoise, ...]
    found: LawSearch
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
    recordings, segments = [], []
    for path in paths:
        recording, rests = still_rests(path, mapping, request.still, say)
        gyroscope_of(recording, rests.triads[0])
        recordings.append(_in_axes(recording, request))
        segments.append(rests)
    # An hour of samples is not held once more than it has to be.
    plain = imu_of(recordings, segments, request.gravity).turns
    demand_axes(plain, str(paths[0]), request.gyro_axes)
    del plain
    tables = [table_of_rests(s, r) for s, r in zip(segments, recordings, strict=True)]
    accelerometer = run_of_rests(tables, recordings, request.of_rests, say)
    # The mark that a correction leaves is not kept: a check sum of its own is not made for it.
    first = replace(accelerometer.calibration, sha256=accelerometer.table.sha256)
    corrected = [
        apply_to_recording(first, recording, found.triads[0], again=True)
        for recording, found in zip(recordings, segments, strict=True)
    ]
    imu = imu_of(corrected, segments, request.gravity)
    say(f"{len(imu.turns.turns)} turns between rests; {len(imu.left_out)} left out")
    pairs = zip(recordings, segments, strict=True)
    longest, still = max(pairs, key=lambda pair: float(np.max(pair[1].stop - pair[1].start)))
    base = joint_fit(imu.turns, declared_terms(request), imu.course)
    found = search_laws(base, imu.course, request)
    held = _predict_held_out(found, imu, request)
    refused = bool(found.said.places) and not held.gained.holds
    every = np.arange(len(imu.turns.turns))
    fits = (_as_read(base), base, found.final)
    raw, before, after = (rms(carried_error(fit, every) / DEG) for fit in fits)
    if refused:
        held, after = replace(held, final=held.base), before
    return ImuResult(
        recordings=tuple(recordings),
        accelerometer=accelerometer,
        imu=imu,
        noise=noise_at_rest((longest,), still),
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


def _predict_held_out(found: LawSearch, imu: ImuLog, request: ImuRequest) -> HeldOutTurns:
    """Blocks of turns in turn, everything chosen without them."""
    count = len(imu.turns.turns)
    folds = min(FOLDS, count)
    part = np.arange(count) * folds // count
    errors = np.zeros((3, count))
    for k in range(folds):
        out = part == k
        base, final = in_fold(found, out, imu.course, request)
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


def demand_axes(log: TurnLog, where: str, stated: AxisMap) -> None:
    """Raise UnreadableInput, with the option that undoes it, where the gyroscope's axes are others
    than the accelerometer's: gravity says, turn by turn. stated : axes that were said already
    """
    turns = sorted(log.turns, key=lambda turn: -turn.lasting)[:_TURNS]
    up = log.force / np.linalg.norm(log.force, axis=1)[:, None]
    before, after = (up[[turn.rest + k for turn in turns]] for k in (0, 1))
    seen = [moved_by(log, log.rate, turn)[0] for turn in turns]
    turned = [
        [attitudes(turn.t, sign * rate)[-1] for sign in (1.0, -1.0)]
        for turn, rate in zip(turns, seen, strict=True)
    ]
    off = misfits(before, after, np.array(turned)[:, None])
    chance, median = weigh(off)[0], np.median(off[:, 0], axis=0)
    best = int(np.argmax(chance))
    if chance[0] > DOUBT:
        return
    own = _matrix(stated.order, stated.sign)
    line = axes_in_words(SIGNED[best] @ own)
    next_ = int(np.argsort(chance)[-2])
    other = f"; {axes_in_words(SIGNED[next_] @ own)} {_percent(chance[next_])}"
    rival = other if chance[next_] > DOUBT else ""
    mirrored = (
        "; one of the two sensors is mirrored, and gravity does not say which"
        if np.linalg.det(SIGNED[best]) < 0.0
        else ""
    )
    raise UnreadableInput(
        f"over {len(turns)} turns the gyroscope carries gravity {median[0] / DEG:.0f} deg past "
        f"where it is, and {median[best] / DEG:.1f} deg where its axes are {line} "
        f"({_percent(chance[best])}{rival}){mirrored}",
        where=where,
        remedy=f"add --gyro-axes={line}",
    )


def _percent(chance: float) -> str:
    return "> 99.9 %" if chance > 1.0 - DOUBT else f"{100.0 * chance:.2g} %"


def _matrix(order: Sequence[int], sign: Sequence[float]) -> Array:
    return np.asarray(np.eye(3)[list(order)] * np.array(sign)[:, None])
