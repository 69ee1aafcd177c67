"""`imucal imu`: accelerometer and gyroscope by the rests of a log and the turns between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.imu.laws import declare_terms
from imucalib.calibrators.imu.log import ImuLog, gyroscope_of, imu_of
from imucalib.calibrators.imu.request import ImuRequest
from imucalib.calibrators.imu.search import LawSearch, joint_fit, refit_without, search_laws
from imucalib.calibrators.lab.bench import observations_of, row_numbers
from imucalib.calibrators.lab.errors import rms
from imucalib.calibrators.lab.files import run_of_rests, still_rests, table_of_rests
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.set_up import DOUBT, SIGNED, axes_in_words, misfits, weigh
from imucalib.errors import UnreadableInput
from imucalib.estimators.carried import attitudes
from imucalib.estimators.turn_log import TurnLog, remove_bias
from imucalib.estimators.turns import TurnFit, carry_error, rest_forces
from imucalib.inspection.noise import SensorNoise, noise_at_rest
from imucalib.posterior.held_out import Difference, difference
from imucalib.recording.mapping import UNCHANGED, AxisMap, FieldMapping
from imucalib.recording.recording import Recording
from imucalib.units import DEG, MG

#: Blocks of a log that are held out; of several logs each is one.
FOLDS = 5
_TURNS = 12  # that are carried


@dataclass(frozen=True)
class Compared:
    """Errors as read, by the base model and by the final one, of the same data."""

    raw: Array
    base: Array
    final: Array

    @property
    def sizes(self) -> tuple[float, float, float]:
        """rms of each."""
        return rms(self.raw), rms(self.base), rms(self.final)


@dataclass(frozen=True)
class HeldOutLog:
    """Errors of what took no part, and what the search gains there.

    turns : (T,) deg, of gravity after a turn; forces : (N,) mg, of its size at a rest; of_turns,
    of_forces, gained : of each, and of both, in units of what the base model leaves
    """

    turns: Compared
    forces: Compared
    of_turns: Difference
    of_forces: Difference
    gained: Difference

    @property
    def proved(self) -> bool:
        """Whether what was gained of one of them is beyond chance: the other may show nothing."""
        return self.of_turns.proved or self.of_forces.proved


@dataclass(frozen=True)
class ImuResult:
    """accelerometer : the bench of the rests, with what was found of it in its model; by_size :
    the same by the sizes of gravity alone, which tells wrong rests
    imu : the log; noise : of the longest rest; found : the search; fit : what is corrected
    turns, forces : as in `HeldOutLog`, of what was fitted
    refused : whether held-out data refuse what the search found"""

    recordings: tuple[Recording, ...]
    accelerometer: LabRun
    by_size: LabRun
    imu: ImuLog
    noise: tuple[SensorNoise, ...]
    found: LawSearch
    fit: TurnFit
    turns: Compared
    forces: Compared
    held_out: HeldOutLog
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
        recording, still = still_rests(path, mapping, request.still, say)
        gyroscope_of(recording, still.triads[0])
        recordings.append(_in_axes(recording, request))
        segments.append(still)
    imu = imu_of(recordings, segments, request.gravity)
    demand_axes(imu.turns, str(paths[0]), request.gyro_axes)
    say(f"{len(imu.turns.turns)} turns between rests; {len(imu.left_out)} left out")
    tables = [table_of_rests(s, r) for s, r in zip(segments, recordings, strict=True)]
    by_size = run_of_rests(tables, recordings, request.of_rests, say)
    wrong = _wrong_rests(by_size, imu.turns.rests)
    rests = observations_of(by_size.table, by_size.raw, by_size.request)
    course = replace(imu.course, rests=rests.context)
    imu = replace(imu, turns=imu.turns.without(wrong), course=course)
    base = joint_fit(imu.turns, declare_terms(request, rests.context), course)
    found = search_laws(base, course, rests, request)
    held = _predict_held_out(found, imu, request)
    refused = bool(found.said.places) and not held.gained.holds
    corrected = not refused and len(found.terms) > len(found.declared)
    fit = base if refused else found.final
    if not corrected:  # whatever a part of the log would have been corrected by
        held = replace(
            held,
            turns=replace(held.turns, final=held.turns.base),
            forces=replace(held.forces, final=held.forces.base),
        )
    told = tuple(t.name for t in found.terms if corrected and not t.of_rate)
    pairs = zip(recordings, segments, strict=True)
    longest, at_rest = max(pairs, key=lambda pair: float(np.max(pair[1].stop - pair[1].start)))
    everywhere = np.ones(len(imu.turns.turns), bool), np.isfinite(imu.turns.force_sd)
    turns, forces = _compare(base, fit, *everywhere, request.gravity, found)
    bench = replace(
        request.of_rests,
        loop=False,
        declare=tuple(dict.fromkeys((*request.of_rests.declare, *told))),
        exclude=tuple((np.flatnonzero(wrong) + 1).tolist()),
    )
    return ImuResult(
        recordings=tuple(recordings),
        accelerometer=run_of_rests(tables, recordings, bench, lambda _: None),
        by_size=by_size,
        imu=imu,
        noise=noise_at_rest((longest,), at_rest),
        found=found,
        fit=fit,
        turns=turns,
        forces=forces,
        held_out=held,
        refused=refused,
    )


def _wrong_rests(by_size: LabRun, count: int) -> Flags:
    """(N,) which rests the size of gravity there shows to be wrong."""
    out = np.ones(count, bool)
    out[row_numbers(by_size.result.observations) - 1] = False
    return out


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


def _predict_held_out(found: LawSearch, imu: ImuLog, request: ImuRequest) -> HeldOutLog:
    """Blocks of a log in turn, or each of several, everything chosen without them."""
    log = imu.turns
    folds = log.sessions or min(FOLDS, log.rests)
    part = log.session if log.sessions else np.arange(log.rests) * folds // log.rests
    of_turn = part[[turn.rest for turn in log.turns]]
    turns, forces = np.zeros((3, len(of_turn))), np.zeros((3, log.rests))
    for k in range(folds):
        out = of_turn == k, part == k
        base, final = refit_without(found, *out, imu.course, request)
        own = _compare(base, final, *out, request.gravity, found)
        for whole, one, at in zip((turns, forces), own, out, strict=True):
            whole[:, at] = one.raw, one.base, one.final
    forces = forces[:, np.isfinite(log.force_sd)]
    every = [Compared(*turns), Compared(*forces)]
    pairs = [(one.base, one.final) for one in every]
    usual = [max(rms(one.base), 1e-12) for one in every]
    both = (np.concatenate([p[k] / u for p, u in zip(pairs, usual, strict=True)]) for k in (0, 1))
    gains = (
        difference(before, after, np.arange(before.size), folds, "rms")
        for before, after in (*pairs, tuple(both))
    )
    of_turns, of_forces, gained = gains
    return HeldOutLog(every[0], every[1], of_turns, of_forces, gained)


def _compare(
    base: TurnFit, final: TurnFit, turns: Flags, rests: Flags, gravity: float, whole: LawSearch
) -> tuple[Compared, Compared]:
    """Of some turns (T,), deg, and rests (N,), mg, what two models leave of gravity. Of a power-up
    that took no part nobody knows the bias: its turns are seen by the accelerometer of the whole,
    since what carries gravity is the gyroscope."""
    fits, at = (_as_read(base), base, final), np.flatnonzero(turns)
    ends = (whole.base, whole.base, whole.base if final is base else whole.final)
    seen = (
        rest_forces(end if base.log.sessions else fit) for fit, end in zip(fits, ends, strict=True)
    )
    carried = (carry_error(fit, at, up) / DEG for fit, up in zip(fits, seen, strict=True))
    forces = (base.log.force, rest_forces(base), rest_forces(final))
    sizes = (gravity / MG * (np.linalg.norm(force[rests], axis=1) - 1.0) for force in forces)
    return Compared(*carried), Compared(*sizes)


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
    seen = [remove_bias(log, log.rate, turn)[0] for turn in turns]
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
        add=(f"--gyro-axes={line}",),
    )


def _percent(chance: float) -> str:
    return "> 99.9 %" if chance > 1.0 - DOUBT else f"{100.0 * chance:.2g} %"


def _matrix(order: Sequence[int], sign: Sequence[float]) -> Array:
    return np.asarray(np.eye(3)[list(order)] * np.array(sign)[:, None])
