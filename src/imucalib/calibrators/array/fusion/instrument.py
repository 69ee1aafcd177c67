"""A calibrated array as an instrument: what its file says, ready for the readings of a log.

Beside every IMU's linear correction stand effects that need the motion: elements that sense beside
their package's middle, delays, sample ages, g-sensitivity, curved responses. What depends on the
time of the calibrated log (drifts, beats) says nothing of another.

A calibration's error moves all samples alike, and each by its own force and rate. To first order
dx = C Jᵀ Λ dy, with C the covariance of the noise, J the derivative of a reading, Λ its weight and
dy what the error adds to it. What turns or scales the whole board moves the motion itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.triads import Triad, effect_covariance
from imucalib.calibrators.array.board.log import NEAR_RANGE
from imucalib.calibrators.array.motion.laws import AT_REST
from imucalib.calibrators.array.motion.terms import (
    BoardMotion,
    Mounted,
    Term,
    board_motion,
    evaluate_lags,
    gain_and_offset,
)
from imucalib.core.effect import MOTION, Response, cross_matrix
from imucalib.core.eigen import eigen
from imucalib.effects import known
from imucalib.errors import UnreadableInput, UsageError
from imucalib.estimators.array.fusion import FusedMotion, Sensed
from imucalib.estimators.array.samples import Pair, slope_by_motion, turning
from imucalib.units import DEG, STANDARD_GRAVITY

_AGE = "sample_age"
_SMALL = 1e-9  # share of an effect beyond its linear part that is rounding
_FLAT = 1e-12  # of the largest variance of an effect's parameters, below which it is rounding
_FEWEST_CLOCKS = 3  # IMUs of which each one's clock shows beside the others'


def along(axes: Array, vectors: Array) -> Array:
    """(T, K, 3) what axes (K, 3, 3), one in a row, see of vectors (T, K, 3)."""
    seen = np.matmul(vectors.transpose(1, 0, 2), axes.transpose(0, 2, 1))
    return np.asarray(seen.transpose(1, 0, 2))


@dataclass(frozen=True)
class Stretch:
    """Readings of K IMUs at the same instants, in the sensors' own axes; NaN where missing.

    t : (T,) s; acceleration : (T, K, 3) m/s²; rate : (T, K, 3) rad/s
    """

    t: Array
    acceleration: Array
    rate: Array

    def take(self, rows: slice | Index | Flags) -> Stretch:
        return Stretch(self.t[rows], self.acceleration[rows], self.rate[rows])

    def of_some(self, imus: Flags) -> Stretch:
        """With the readings of some of the IMUs, those of the others missing."""
        one, two = (np.where(imus[:, None], v, np.nan) for v in (self.acceleration, self.rate))
        return Stretch(self.t, one, two)


@dataclass(frozen=True)
class _Part:
    """A term less what the file's gain (K, 3, 3) and offset (K, 3) hold of it."""

    term: Term
    gain: Array
    offset: Array

    @property
    def late(self) -> bool:
        """Whether it adds dω/dt to a gyro's rate, and nothing else."""
        return self.term.gyro and set(self.term.effect.needs) <= {"spin", _AGE}

    @property
    def lags(self) -> bool:
        """Whether it says when its sensors read, by what a motion over time holds."""
        return self.term.effect.lagged is not None and not self.term.aged

    def evaluate(self, motion: BoardMotion) -> Array:
        """(T, K, 3) in board axes."""
        return self.term.beyond(motion, self.gain, self.offset)


@dataclass(frozen=True)
class NonlinearTerms:
    """imus, rotations : (K, 3, 3) package axes to board axes; back : for accelerometers and gyros,
    (K, 3, 3) that turns what is added to readings into what is wrong with corrected ones
    span : s of the gyros' sawtooth sample ages, 0 without; left_out : effects that belong to the
    calibrated log's time; refuted : effects that the log's own rests contradict"""

    imus: tuple[str, ...]
    rotations: Array
    parts: tuple[_Part, ...]
    back: Pair
    span: float
    left_out: tuple[str, ...]
    refuted: tuple[str, ...] = ()

    def without(self, names: Sequence[str]) -> NonlinearTerms:
        """Without effects that a log contradicts."""
        kept = tuple(p for p in self.parts if p.term.name not in names)
        return replace(self, parts=kept, refuted=(*self.refuted, *names))

    @property
    def lagging(self) -> list[_Part]:
        """What makes sensors lag by more than their clocks' ages."""
        return [part for part in self.parts if part.lags]

    def evaluate(self, motion: BoardMotion) -> Pair:
        """(T, K, 3) m/s² and rad/s that corrected readings still hold, in board axes, of lags the
        first order; without what `late` tells."""
        found = Pair(np.zeros((*motion.shape, 3)), np.zeros((*motion.shape, 3)))
        for part in self.parts:
            if not part.late:
                found[part.term.gyro][...] += part.evaluate(motion)
        return self._correct(found)

    def evaluate_lags(self, motion: BoardMotion) -> Pair:
        """The same of lags beyond their first order, where the motion has its courses."""
        lagging = self.lagging
        more = evaluate_lags([part.term for part in lagging], motion)
        for part in lagging:
            more[part.term.gyro][...] -= part.evaluate(motion)
        return self._correct(more)

    def _correct(self, found: Pair) -> Pair:
        return Pair(*map(along, self.back, found))

    def late(self, t: Array, age: Array | None) -> Array | None:
        """(T, K, 3, 3) s: corrected gyros read ω + late dω/dt at times t (T,) s. age : (T, K) unit
        sawtooths or None. None where nothing is late."""
        parts = [p for p in self.parts if p.late and not (p.term.aged and age is None)]
        if not parts:
            return None
        out = np.zeros((len(t), len(self.imus), 3, 3))
        for axis, one in enumerate(np.eye(3)):
            motion = board_motion(self, t, spin=np.broadcast_to(one, (len(t), 3)), age=age)
            for part in parts:
                out[..., axis] += part.term.reading(motion)
        return np.asarray(self.back[1] @ out)


def read_nonlinear(calibration: Calibration) -> NonlinearTerms:
    """From the effects that an array's calibration lists."""
    triads, parts, left_out, span = calibration.triads, [], [], 0.0
    gains = np.tile(np.eye(3), (2, len(triads), 1, 1))
    imus, rotations = tuple(t.name for t in triads), np.array([t.rotation for t in triads])
    bare = NonlinearTerms(imus, rotations, (), Pair(*gains), 0.0, ())
    for block in calibration.facts.get("effects", ()):
        name = str(block["effect"])
        term = _term_of(block, imus)
        if term is None:
            left_out.append(name)
            continue
        gain, offset = term.slope_at_rest(bare)
        if name.startswith(AT_REST):  # the rests' gains stand without it
            gain = np.zeros_like(gain)
        part = _Part(term, gain, offset)
        gains[int(term.gyro)] += gain
        if not _is_linear(part, bare):
            parts.append(part)
        if term.aged:
            span = 1e-3 * abs(float(term.value[0]))
    back = Pair(*np.linalg.inv(gains))
    return replace(bare, parts=tuple(parts), back=back, span=span, left_out=tuple(left_out))


def _is_linear(part: _Part, board: Mounted) -> bool:
    """Whether the file's gain and offset hold all of it: tried at some motions."""
    n, k, rng = 16, len(board.imus), np.random.default_rng(0)
    force = 10.0 * rng.normal(size=(n, k, 3))
    motion = board_motion(
        board,
        np.arange(float(n)),
        rate=10.0 * rng.normal(size=(n, 3)),
        spin=500.0 * rng.normal(size=(n, 3)),
        force=force,
        jerk=100.0 * force,
        age=rng.uniform(-0.5, 0.5, (n, k)),
    )
    whole = part.term.reading(motion)
    return bool(np.abs(part.evaluate(motion)).max() <= _SMALL * np.abs(whole).max())


def _term_of(block: Mapping[str, Any], imus: Sequence[str]) -> Term | None:
    """An effect of the file that any motion drives; None for all others."""
    name = str(block["effect"]).removeprefix(AT_REST)
    whole, _, imu = name.partition("@")
    effect = known(whole)
    if not isinstance(effect, Response) or not set(effect.needs) <= {*MOTION, _AGE}:
        return None
    theta = np.array([float(p["value"]) for p in block["parameters"]])
    only = imus.index(imu) if imu in imus else None
    if (imu and only is None) or len(theta) % len(effect.each):
        return None
    return Term(name, effect, only, np.eye(len(theta)), theta, np.ones_like(theta))


@dataclass(frozen=True)
class Doubt:
    """What a calibration leaves open.

    places : (3 K, 3 K) m² of the positions by the calibration's motion; triads : (K, 12, 12) of
    gains (rows first) and biases (m/s²), each IMU's by itself; gravity, scale : relative sds of the
    force and of all gyros' rates; frame : (3,) rad; effects : terms with a root (p, q) of the
    covariance of their parameters"""

    places: Array
    triads: Array
    gravity: float
    scale: float
    frame: Array
    effects: tuple[tuple[Term, Array], ...]

    def propagate(self, motion: FusedMotion, sensed: Sensed, r: Array, seen: BoardMotion) -> Array:
        """(T, 9, 9) covariance of force, dω/dt and ω by it.

        motion : with the covariance of the noise, as `sensed` gives it; r : (K, 3) m; seen : the
        motion as effects take it
        """
        force, rate = _answers(motion, sensed, r)
        moved = np.matmul(force, turning(motion.rate, motion.spin)[:, None])  # by a place
        across = moved.transpose(0, 2, 1, 3).reshape(-1, 9, 3 * len(r))
        out = np.matmul(across @ self.places, across.transpose(0, 2, 1))
        by = np.matmul(force, gain_and_offset(motion.predict_force(r)))
        out += np.matmul(by @ self.triads, by.swapaxes(2, 3)).sum(axis=1)
        for term, root in self.effects:
            gain = rate if term.gyro else force
            columns = term.columns(seen)
            by = np.matmul(gain, columns.basis.swapaxes(0, 1))  # (T, K, 9, m)
            by = by.sum(axis=1, keepdims=True) if columns.shared else by
            by = by.swapaxes(1, 2).reshape(len(by), 9, -1) @ root
            out += np.matmul(by, by.swapaxes(1, 2))
        by = self._of_the_whole(motion, sensed)
        return np.asarray(out + np.matmul(by, by.swapaxes(1, 2)))

    def _of_the_whole(self, motion: FusedMotion, sensed: Sensed) -> Array:
        """(T, 9, 5) by gravity, the gyros' common scale and the frame.

        Readings (1 + k) ω have given positions 1/(1 + k)², so that forces agree, the accelerometers
        show dω/dt too large by 2 k, and neighbours' rates by k.
        """
        columns, share = np.zeros((len(motion.rate), 9, 5)), np.zeros_like(motion.rate)
        if sensed.spin_precision is not None:
            share = np.einsum("tii->ti", motion.covariance)[:, 3:6] * sensed.spin_precision
        columns[:, :3, 0] = self.gravity * motion.force
        columns[:, 3:6, 1] = self.scale * (2.0 - np.clip(share, 0.0, 1.0)) * motion.spin
        columns[:, 6:, 1] = self.scale * motion.rate
        for at, vector in ((0, motion.force), (3, motion.spin), (6, motion.rate)):
            columns[:, at : at + 3, 2:] = -cross_matrix(vector) * self.frame
        return columns


def _answers(motion: FusedMotion, sensed: Sensed, r: Array) -> Pair:
    """(T, K, 9, 3) what a reading's error does to the motion, of accelerometers and of gyros."""
    t, k = sensed.force.shape[:2]
    place = np.concatenate([np.ones((k, 1)), r], axis=1)
    slope = slope_by_motion(motion.rate).reshape(t, 3, 4, 9).transpose(0, 1, 3, 2)
    arms = np.matmul(slope, place.T).transpose(0, 3, 2, 1)  # (T, K, 9, 3)
    whole = motion.covariance[:, None]
    force = np.matmul(whole, np.matmul(arms, sensed.force_precision))
    seen = np.zeros((t, k, 9, 3))
    seen[:, :, 6:] = sensed.rate_precision
    if sensed.late is not None:
        seen[:, :, 3:6] = np.matmul(sensed.late.swapaxes(2, 3), sensed.rate_precision)
    return Pair(force, np.matmul(whole, seen))


def doubt_of(calibration: Calibration, places: Array) -> Doubt | None:
    """Of an array's calibration with positions (K, 3) m about the first IMU; None where its file
    does not say how well positions are known."""
    facts, count = calibration.facts, len(calibration.triads)
    free = 3 * (count - 1)
    if calibration.covariance.shape != (free, free) or not calibration.covariance.any():
        return None
    size, stated = facts.get("size", {}), facts.get("frame", {}).get("sd_deg", 0.0)
    frame = np.broadcast_to(np.asarray(stated, dtype=float), (3,)) * DEG
    # What size and frame have put into the positions stands by itself.
    about = np.stack([np.cross(axis, places[1:]).ravel() for axis in np.eye(3)], axis=1) * frame
    larger = float(size.get("sd_beyond_motion", 0.0)) * places[1:].ravel()
    own = 1e-6 * calibration.covariance - about @ about.T - np.outer(larger, larger)
    values, vectors = eigen(own)
    whole = np.zeros((3 * count, 3 * count))
    whole[3:, 3:] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return Doubt(
        places=whole,
        triads=np.array([t.covariance for t in calibration.triads]),
        gravity=float(size.get("sd_of_gravity", 0.0)),
        scale=float(facts.get("gyro_scale", {}).get("sd", 0.0)),
        frame=frame,
        effects=tuple(_add_doubt(calibration)),
    )


def _add_doubt(calibration: Calibration) -> Iterator[tuple[Term, Array]]:
    imus = tuple(t.name for t in calibration.triads)
    for block in calibration.facts.get("effects", ()):
        term = None if str(block["effect"]).startswith(AT_REST) else _term_of(block, imus)
        if term is None or term.aged:
            continue
        values, vectors = eigen(effect_covariance(block))
        seen = values > _FLAT * float(values[-1])
        if seen.any():
            yield term, np.asarray(vectors[:, seen] * np.sqrt(values[seen]))


@dataclass(frozen=True)
class Biases:
    """What corrected readings still hold at rest, in board axes.

    force : (K, 3) m/s²; at : (m,) s; rate : (m, K, 3) rad/s at these times, straight between them
    """

    force: Array
    at: Array
    rate: Array

    def rate_at(self, t: Array) -> Array:
        """(T, K, 3) rad/s at times t (T,) s; beyond the ends as at the ends."""
        each = [np.interp(t, self.at, one) for one in self.rate.reshape(len(self.at), -1).T]
        return np.stack(each, axis=1).reshape(len(t), *self.rate.shape[1:])


@dataclass(frozen=True)
class Instrument:
    """K IMUs whose readings become one motion.

    r : (K, 3) m, positions about the point whose specific force is wanted, which lies at `at` (m)
        in the frame of the board's drawing
    beyond : what found effects add beyond the linear correction
    accelerometer_range, gyroscope_range : m/s² and rad/s; inf where not known
    biases : what the log's own rests show beside the calibration's, None where these hold
    doubt : what the calibration leaves open, None where its file does not say
    partner : of a log that was looked through, its sensors -> indices of the triads
    """

    triads: tuple[Triad, ...]
    r: Array
    at: Array
    beyond: NonlinearTerms
    accelerometer_range: float
    gyroscope_range: float
    biases: Biases | None = None
    doubt: Doubt | None = None
    partner: Mapping[str, int] | None = None

    @property
    def imus(self) -> tuple[str, ...]:
        return self.beyond.imus

    @property
    def clocked(self) -> bool:
        """Whether gyros read by clocks of their own that a log can show."""
        return self.beyond.span > 0.0 and len(self.triads) >= _FEWEST_CLOCKS

    @property
    def axes(self) -> Pair:
        """(K, 3, 3), in its rows what each axis of a sensor senses, in board axes."""
        return Pair(
            np.array([t.rotation.T @ t.gain for t in self.triads]),
            np.array([t.rotation.T @ t.gyro_gain for t in self.triads]),
        )

    def correct(self, read: Stretch) -> Pair:
        """Force and rate (T, K, 3) in board axes; of a missing reading, as if it were zero."""
        force, rate = (
            np.stack([one(np.nan_to_num(values[:, k])) for k, one in enumerate(by)], axis=1)
            for values, by in (
                (read.acceleration, [t.force for t in self.triads]),
                (read.rate, [t.rate for t in self.triads]),
            )
        )
        found = Pair(force, rate)
        known = self.biases
        return found if known is None else found.less(Pair(known.force, known.rate_at(read.t)))

    def find_clipped(self, read: Stretch) -> tuple[Flags, Flags]:
        """(T, K, 3) which readings are at the end of their range."""
        return (
            np.asarray(np.abs(read.acceleration) >= NEAR_RANGE * self.accelerometer_range),
            np.asarray(np.abs(read.rate) >= NEAR_RANGE * self.gyroscope_range),
        )


def instrument_of(calibration: Calibration, at: Array | None = None) -> Instrument:
    """The instrument of an array's calibration.

    at : (3,) m in the frame of the board's drawing, the point whose specific force is wanted; by
        default the middle of the IMUs, where it is known best
    Raises UsageError for a calibration that is not of an array, UnreadableInput for one whose
    positions do not fit its IMUs.
    """
    if not calibration.triads:
        raise UsageError(
            f"a calibration by {calibration.calibrator} is of one sensor, there is nothing to fuse",
            remedy="use the calibration of an array",
        )
    facts, triads = calibration.facts, calibration.triads
    try:
        rows = {str(row["imu"]): row["mean"] for row in facts["positions_mm"]}
        places = 1e-3 * np.array([rows[t.name] for t in triads], dtype=float).reshape(-1, 3)
        first = 1e-3 * np.array(facts.get("reference_mm", np.zeros(3)), dtype=float).reshape(3)
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableInput(f"the positions do not fit the IMUs: {error!r}") from None
    drawn = places + first
    point = drawn.mean(axis=0) if at is None else at
    ranges = {n: v for n, v in facts.get("ranges", {}).items() if v is not None}
    return Instrument(
        triads=triads,
        r=drawn - point,
        at=point,
        beyond=read_nonlinear(calibration),
        accelerometer_range=float(ranges.get("accelerometer_g", np.inf)) * STANDARD_GRAVITY,
        gyroscope_range=float(ranges.get("gyroscope_deg_per_s", np.inf)) * DEG,
        doubt=doubt_of(calibration, places - places[0]),
    )
