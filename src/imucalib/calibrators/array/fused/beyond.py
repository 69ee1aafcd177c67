"""What found effects add beyond every IMU's linear correction: it needs the motion.

Elements that sense beside their package's middle, delays, sample ages, g-sensitivity, curved
responses. What depends on the time of the calibrated log (drifts, beats) says nothing of another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.array.linear_part import slope_at_rest
from imucalib.calibrators.array.loop.at_rest import AT_REST
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.loop.terms import Term, lost
from imucalib.core.context import MOTION
from imucalib.core.effect import Response
from imucalib.effects import known

_AGE = "sample_age"
_SMALL = 1e-9  # share of an effect beyond its linear part that is rounding


@dataclass(frozen=True)
class _Part:
    """A term less what the file's gain (K, 3, 3) and offset (K, 3) hold of it."""

    term: Term
    gain: Array
    offset: Array

    @property
    def gyro(self) -> bool:
        return self.term.effect.channel == "angular_rate"

    @property
    def late(self) -> bool:
        """Whether it adds dω/dt to a gyro's rate, and nothing else."""
        return self.gyro and set(self.term.effect.needs) <= {"spin", _AGE}

    @property
    def lags(self) -> bool:
        """Whether it says when its sensors read, by what a motion over time holds."""
        return self.term.effect.lagged is not None and not self.term.aged

    def added(self, motion: BoardMotion) -> Array:
        """(T, K, 3) in board axes."""
        truth = motion.truth.turning.rate if self.gyro else motion.truth.force
        drive = motion.context.in_common(truth)
        whole = self.term.reading(self.term.columns(motion))
        linear = np.matmul(drive.transpose(1, 0, 2), self.gain.transpose(0, 2, 1))
        return np.asarray(whole - linear.transpose(1, 0, 2) - self.offset)


@dataclass(frozen=True)
class Beyond:
    """imus, rotations : (K, 3, 3) package axes to board axes; back : for accelerometers and gyros,
    (K, 3, 3) that turns what is added to readings into what is wrong with corrected ones
    span : s of the gyros' sawtooth sample ages, 0 without; left_out : effects that belong to the
    calibrated log's time; listed : whether the calibration lists effects at all
    refuted : effects that the log's own rests contradict"""

    imus: tuple[str, ...]
    rotations: Array
    parts: tuple[_Part, ...]
    back: tuple[Array, Array]
    span: float
    left_out: tuple[str, ...]
    listed: bool = True
    refuted: tuple[str, ...] = ()

    def without(self, names: Sequence[str]) -> Beyond:
        """Without effects that a log contradicts."""
        kept = tuple(p for p in self.parts if p.term.name not in names)
        return replace(self, parts=kept, refuted=(*self.refuted, *names))

    @property
    def needs_jerk(self) -> bool:
        return any("jerk" in part.term.effect.needs for part in self.parts)

    @property
    def lags(self) -> bool:
        """Whether sensors lag by more than their clocks' ages."""
        return any(part.lags for part in self.parts)

    def added(
        self, motion: BoardMotion, beside: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """(T, K, 3) m/s² and rad/s that corrected readings still hold, in board axes; without what
        `late` tells. Lags are whole where the motion has its courses, else to the first order.

        beside : what `besides_lags` says of this motion, where it is known
        """
        found = [one.copy() for one in beside or self.besides_lags(motion)]
        lagging = [p for p in self.parts if p.lags]
        if lagging and motion.courses is not None:
            less = lost([p.term for p in lagging], motion)
            found = [one - own for one, own in zip(found, less, strict=True)]
        for part in lagging:
            if motion.courses is None:
                found[part.gyro] += 0.0 if part.late else part.added(motion)
            elif part.late:
                found[1] -= part.added(motion)
        one, two = (
            np.matmul(a.transpose(1, 0, 2), back.transpose(0, 2, 1)).transpose(1, 0, 2)
            for a, back in zip(found, self.back, strict=True)
        )
        return one, two

    def besides_lags(self, motion: BoardMotion) -> tuple[Array, Array]:
        """(T, K, 3) what effects add to readings that do not say when these are made."""
        found = np.zeros((*motion.shape, 3)), np.zeros((*motion.shape, 3))
        for part in self.parts:
            if not part.late and not part.lags:
                found[part.gyro][...] += part.added(motion)
        return found

    def late(self, t: Array, age: Array | None) -> Array | None:
        """(T, K, 3, 3) s: corrected gyros read ω + late dω/dt at times t (T,) s. age : (T, K) unit
        sawtooths or None. None where nothing is late."""
        parts = [p for p in self.parts if p.late and not (p.term.aged and age is None)]
        if not parts:
            return None
        shape = (len(t), len(self.imus))
        out, zero, none = np.zeros((*shape, 3, 3)), np.zeros((len(t), 3)), np.zeros((*shape, 3))
        for axis in range(3):
            spin = np.broadcast_to(np.eye(3)[axis], (len(t), 3))
            motion = board_motion(
                imus=self.imus, rotations=self.rotations, t=t, order=np.full(len(t), 0.5),
                rate=zero, spin=spin, force=none, jerk=none, age=age,
            )  # fmt: skip
            for part in parts:
                out[..., axis] += part.term.reading(part.term.columns(motion))
        return np.asarray(self.back[1] @ out)


def beyond_linear(calibration: Calibration) -> Beyond:
    """From the effects that an array's calibration lists."""
    imus = tuple(t.name for t in calibration.triads)
    rotations = np.array([t.rotation for t in calibration.triads])
    parts, left_out = [], []
    gains = [np.tile(np.eye(3), (len(imus), 1, 1)) for _ in range(2)]
    span = 0.0
    for block in calibration.facts.get("effects", ()):
        name = str(block["effect"])
        term = term_of(block, imus)
        if term is None:
            left_out.append(name)
            continue
        gain, offset = slope_at_rest(term, imus, rotations)
        if name.startswith(AT_REST):  # the rests' gains stand without it
            gain = np.zeros_like(gain)
        gains[term.effect.channel == "angular_rate"] += gain
        part = _Part(term, gain, offset)
        if not _is_linear(part, imus, rotations):
            parts.append(part)
        if term.aged:
            span = 1e-3 * abs(float(term.value[0]))
    one, two = (np.asarray(np.linalg.inv(gain), np.float64) for gain in gains)
    listed = "effects" in calibration.facts
    return Beyond(
        imus=imus, rotations=rotations, parts=tuple(parts), back=(one, two), span=span,
        left_out=tuple(left_out), listed=listed,
    )  # fmt: skip


def _is_linear(part: _Part, imus: tuple[str, ...], rotations: Array) -> bool:
    """Whether the file's gain and offset hold all of it: tried at some motions."""
    n, rng = 16, np.random.default_rng(0)
    force = 10.0 * rng.normal(size=(n, len(imus), 3))
    rate, spin = 10.0 * rng.normal(size=(n, 3)), 500.0 * rng.normal(size=(n, 3))
    motion = board_motion(
        imus=imus, rotations=rotations, t=np.arange(float(n)), order=np.full(n, 0.5), rate=rate,
        spin=spin, force=force, jerk=100.0 * force, age=rng.uniform(-0.5, 0.5, (n, len(imus))),
    )  # fmt: skip
    whole = part.term.reading(part.term.columns(motion))
    return bool(np.abs(part.added(motion)).max() <= _SMALL * np.abs(whole).max())


def term_of(block: Mapping[str, Any], imus: Sequence[str]) -> Term | None:
    """An effect of the file that any motion drives; None for all others."""
    name = str(block["effect"]).removeprefix(AT_REST)
    whole, _, imu = name.partition("@")
    effect = known(whole)
    driven = {*MOTION, _AGE}
    if not isinstance(effect, Response) or not set(effect.needs) <= driven:
        return None
    theta = np.array([float(p["value"]) for p in block["parameters"]])
    only = imus.index(imu) if imu in imus else None
    if (imu and only is None) or len(theta) % len(effect.each):
        return None
    one = np.ones_like(theta)
    return Term(name, effect, only, np.eye(len(theta)), theta, one)
