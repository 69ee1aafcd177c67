"""Which numbers of a board repeat from log to log, and which are anew at every power-up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.logs.pooled import Pooled, pooled
from imucalib.calibrators.array.run import ArrayRun
from imucalib.units import DEG

_ALPHA = 0.01  # p of the agreement from which on numbers are said to repeat
_LARGE = 3.0  # between logs over stated, above which they do not, whatever p says


@dataclass(frozen=True)
class Repeat:
    """Numbers of one kind in all logs. name, unit; each : names of the p numbers
    values, sds : (n, p) of every log; found : pooled, the numbers taken as independent"""

    name: str
    unit: str
    each: tuple[str, ...]
    values: Array
    sds: Array
    found: Pooled

    @property
    def between(self) -> float:
        """Rms over the numbers of the sd between logs."""
        return float(np.sqrt(np.mean(self.found.between**2)))

    @property
    def stated(self) -> float:
        return float(np.sqrt(np.mean(self.sds**2)))

    @property
    def holds(self) -> bool:
        """Whether the logs agree on them within what they state, or nearly."""
        return self.found.p >= _ALPHA or self.found.tau < self.stated * (_LARGE - 1.0)


def repeats(runs: Sequence[ArrayRun]) -> tuple[Repeat, ...]:
    """Gains, offsets, and the parameters of effects that every log has found."""
    imus = runs[0].board.imus
    in_board = [run.rests.in_board_axes() for run in runs]
    gain = np.array([g.ravel() for g, _, _ in in_board])
    own = np.array([np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for _, _, c in in_board])
    nine = tuple(f"{imu}.{a}{b}" for imu in imus for a in "xyz" for b in "xyz")
    three = tuple(f"{imu}.{a}" for imu in imus for a in "xyz")
    n = len(runs)
    rows = [
        _repeat("accelerometer gains", "1", nine, gain, own[:, :, :9].reshape(n, -1)),
        _repeat("accelerometer biases", "m/s²", three,
                np.array([b.ravel() for _, b, _ in in_board]), own[:, :, 9:].reshape(n, -1)),
        _repeat("gyro biases", "deg/s", three,
                np.array([run.rests.gyro_bias[0].ravel() / DEG for run in runs]),
                np.array([run.rests.gyro_bias_sd.ravel() / DEG for run in runs])),
    ]  # fmt: skip
    return (*rows, *_effects(runs))


def _effects(runs: Sequence[ArrayRun]) -> list[Repeat]:
    terms = [run.loop.final.found if run.loop else () for run in runs]
    shared = [t.name for t in terms[0] if all(any(u.name == t.name for u in x) for x in terms)]
    found = []
    for name in shared:
        values, sds = [], []
        for run, own in zip(runs, terms, strict=True):
            assert run.loop is not None
            term = next(t for t in own if t.name == name)
            values.append(term.theta)
            sds.append(run.loop.final.sd_of(term))
        parameters = term.parameters(run.board.imus)
        each = tuple(p.name for p in parameters)
        if len({len(v) for v in values}) == 1:
            found.append(_repeat(name, parameters[0].unit, each, np.array(values), np.array(sds)))
    return found


def _repeat(name: str, unit: str, each: tuple[str, ...], values: Array, sds: Array) -> Repeat:
    # What no log determines is held at zero in all of them: it says nothing of their agreement.
    told = np.maximum(sds, 1e-6 * max(float(sds.max()), 1e-300))
    found = pooled(values, np.array([np.diag(s**2) for s in told]))
    return Repeat(name, unit, each, values, sds, found)
