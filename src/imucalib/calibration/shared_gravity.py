"""Gravity at rest tells whether a recording's sensors are those that were calibrated: by its size,
and by its being one for all IMUs of an array.

At rest the corrected forces of all IMUs, turned into the board's axes, are one vector. What they
differ by is held against the same readings paired otherwise, and against what is stated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import lgamma, log

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.triads import Triad
from imucalib.errors import Undetermined, UsageError
from imucalib.recording.recording import Channel
from imucalib.rests.segments import Segments
from imucalib.units import MG, STANDARD_GRAVITY

#: Prior odds of the pairing by name against all others together: 99 to 1.
_PRIOR = log(100.0)
#: m/s² that no accelerometer's bias changes by while it works: zero-g levels of data sheets, over
#: life and temperature, stay below a tenth of g; another axis or sign is worth more than half of g.
_ANOTHER_SENSOR = 0.25 * STANDARD_GRAVITY
_SURE = 5.0  # standard deviations from which a change is stated
#: s of a window; those are quiet that scatter at most so many times what this share of them does.
_SECONDS, _LOUDER, _QUIET = 1.0, 2.0, 0.1


class GravityAtRest:
    """What a correction does to the size of gravity, from windows of a recording's blocks."""

    def __init__(self) -> None:
        self._windows: list[Array] = []

    def add(self, channel: Channel, corrected: Array) -> None:
        """A block: readings (n, 3) and what they are corrected to, m/s²."""
        width = max(3, round(_SECONDS * channel.rate))
        shape = (len(corrected) // width, width, 3)
        before, after = (v[: shape[0] * width].reshape(shape) for v in (channel.values, corrected))
        sizes = (np.linalg.norm(v.mean(axis=1), axis=1) for v in (before, after))
        scatter = np.sqrt(before.var(axis=1).sum(axis=1))
        self._windows.append(np.column_stack([scatter, *sizes]))

    def off(self, gravity: float) -> tuple[float, float, float] | None:
        """mg rms where it is quiet: scatter within a window, and by how much |a| is off
        gravity before and after; None where nothing was recorded."""
        every = np.concatenate([*self._windows, np.zeros((0, 3))])
        every = every[np.isfinite(every).all(axis=1) & (every[:, 0] > 0.0)]
        every[:, 1:] -= gravity
        if not len(every):
            return None
        quiet = every[every[:, 0] <= _LOUDER * np.quantile(every[:, 0], _QUIET)]
        scatter, before, after = np.sqrt(np.mean(quiet**2, axis=0)) / MG
        return float(scatter), float(before), float(after)

    def words(self, gravity: float) -> tuple[str, ...]:
        """What is to be said of it."""
        if (off := self.off(gravity)) is None:
            return ()
        where = "where the recording is quietest, |a| is off gravity by"
        return (f"{where} {off[1]:.3g} mg as read, {off[2]:.3g} mg corrected (rms)",)

    def demand_better(self, gravity: float, stated: float, where: str) -> None:
        """Raise UsageError where gravity is off by more than motion can be, and after the
        correction by no less than before and what the calibration is good to; stated : mg rms"""
        off = self.off(gravity)
        if off is not None and off[0] < off[1] and off[2] >= np.hypot(off[1], stated):
            raise UsageError(
                f"{self.words(gravity)[0]}: the calibration is another sensor's",
                where=where,
                remedy="give the calibration of this one; if it is the same, insist",
                add=("--same-device",),
            )


def check_against_gravity(
    triads: Sequence[Triad], partner: Mapping[str, int], segments: Segments, where: str
) -> tuple[str, ...]:
    """What is to be said of how the IMUs agree on gravity.

    triads : of the calibration; partner : recorded sensor -> index of its triad, as paired
    segments : the recording's rests, m/s²; without any, or of one sensor, nothing is compared
    Raises Undetermined where another pairing agrees and this one does not, with that pairing, and
    where a sensor is off by more than any bias changes by.
    """
    names = [name for name in partner if name in segments.triads]
    if segments.n == 0 or len(names) < 2:
        return ()
    read = segments.mean[:, [segments.triads.index(name) for name in names]]
    given = np.array([partner[name] for name in names], dtype=np.intp)
    # (J, K, m, 3) m/s², recorded sensor j corrected as IMU k at m rests.
    force = np.array([[t.force(read[:, j]) for t in triads] for j in range(len(names))])
    variance = _variance(triads, segments, names, given, force)
    own, best = _disagreement(force, given), _best(force)
    other = _disagreement(force, best)
    freedom = 3.0 * (len(names) - 1)
    noise = max(float(variance.mean()), float(other.sum()) / freedom)
    ahead = float(own.sum() - other.sum()) / (2.0 * noise)
    if ahead > lgamma(len(names) + 1.0) + _PRIOR:
        rows = zip(names, given, best, strict=True)
        others = (f"{n} is {triads[b].name}, not {triads[a].name}" for n, a, b in rows if a != b)
        raise Undetermined(
            f"at rest the corrected accelerometers disagree about gravity by up to "
            f"{np.sqrt(own.max()) / MG:.3g} mg; paired otherwise, by {_in_mg(other)} mg",
            where=where,
            remedy="if these are the sensors that were calibrated, name the recording's so with a "
            "mapping (key triads): " + ", ".join(others),
        )
    worst = int(np.argmax(own))
    if own[worst] > _ANOTHER_SENSOR**2:
        raise Undetermined(
            f"at rest {names[worst]} disagrees with the others about gravity by "
            f"{_in_mg(own)} mg: its axes or its unit are not those that were calibrated",
            where=where,
            remedy="look at `imucal inspect` of both recordings; leave the sensor out, or "
            "calibrate the board again",
        )
    changed = np.flatnonzero(own > 3.0 * _SURE**2 * variance)
    if not changed.size:
        return ()
    sizes = ", ".join(f"{names[j]} by {np.sqrt(own[j]) / MG:.2g} mg" for j in changed)
    return (f"gravity at rest is no longer the same for all IMUs: {sizes}",)


def _in_mg(square: Array) -> str:
    return f"{np.sqrt(float(square.max())) / MG:.3g}"


def _variance(
    triads: Sequence[Triad], segments: Segments, names: Sequence[str], given: Index, force: Array
) -> Array:
    """(J,) (m/s²)² of an axis, by the stated covariance of each sensor's IMU, in the mean over the
    rests, and by the noise of its samples."""
    columns = [segments.triads.index(name) for name in names]
    samples = np.maximum(segments.samples[:, columns], 1)
    noise = np.mean((segments.noise[columns] ** 2).mean(axis=1) / samples, axis=0)
    stated = [
        np.einsum("mii->mi", triads[k].force_covariance(force[j, k])) for j, k in enumerate(given)
    ]
    return np.asarray([float(np.maximum(one, 0.0).mean()) for one in stated] + noise)


def _disagreement(force: Array, pairing: Index) -> Array:
    """(J,) (m/s²)² of each sensor from the mean of all, in the mean over the rests."""
    own = force[np.arange(len(pairing)), pairing]
    return np.asarray(((own - own.mean(axis=0)) ** 2).sum(axis=2).mean(axis=1))


def _best(force: Array) -> Index:
    """(J,) the pairing of least disagreement: the first sensor as each IMU in turn is what the
    others are held against, which leaves one linear assignment each."""
    from scipy.optimize import linear_sum_assignment

    found, least = np.arange(force.shape[0]), np.inf
    for k in range(force.shape[1]):
        cost = ((force - force[0, k]) ** 2).sum(axis=3).mean(axis=2)
        cost[0] = np.where(np.arange(force.shape[1]) == k, 0.0, 1e12)
        pairing = np.asarray(linear_sum_assignment(cost)[1], dtype=np.intp)
        if (total := float(_disagreement(force, pairing).sum())) < least:
            found, least = pairing, total
    return found
