"""The fitted motion of a board as effects take it: every triad's truth in its own axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.core.course import Course, course_of
from imucalib.core.effect import Channel, Context, Motion, Truth


@dataclass(frozen=True)
class BoardMotion:
    """The truth at T instants as K triads see it, and what else is known of it; of_gyros : the
    same for gyros, where they or the accelerometers lag; courses : of the rate and of the specific
    force as they are, where sensors may lag"""

    truth: Truth
    context: Context
    of_gyros: Truth | None = None
    courses: tuple[Course, Course] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(T, K)."""
        return self.context.n, len(self.context.triads)

    def turn_to_board(self, basis: Array) -> Array:
        """(K, T, 3, m) in board axes, of a basis (T, K, 3, m) in each package's."""
        attitude = self.context.attitude
        assert attitude is not None
        t, k, _, m = basis.shape
        out = np.zeros((k, t, 3, m))
        # Mountings are mostly signed permutations: of nine products three are there.
        for triad, i, j in np.argwhere(attitude):
            out[triad, :, i] += attitude[triad, i, j] * basis[:, triad, j]
        return out

    def set_ages(self, age: Array | None) -> BoardMotion:
        """With the (T, K) sawtooth ages of the gyros' readings, or without any."""
        rest = {k: v for k, v in self.context.covariates.items() if k != "sample_age"}
        known = rest if age is None else {**rest, "sample_age": age}
        return replace(self, context=replace(self.context, covariates=known))

    def set_courses(self, neighbours: Flags) -> BoardMotion:
        """With the courses of rate and force, of which lagging sensors meet a part.

        neighbours : (T, 2) whether the sample before and the one after are next to it
        """
        turning, t = self.truth.turning, self.context["time"]
        rate, force = (
            course_of(value, slope, t, neighbours)
            for value, slope in ((turning.rate, turning.spin), (self.truth.force, turning.jerk))
        )
        return replace(self, courses=(rate, force))

    def set_met(self, gyros: tuple[Course, Course], forces: tuple[Course, Course]) -> BoardMotion:
        """Where gyros and accelerometers meet these courses of rate and force."""
        of_gyros, truth = (
            Truth(force.value, Motion(rate.value, rate.slope, force.slope))
            for rate, force in (gyros, forces)
        )
        return replace(self, of_gyros=of_gyros, truth=truth)

    def truth_of(self, channel: Channel) -> Truth:
        """What the sensors of a kind are exposed to when they read."""
        if channel == "angular_rate" and self.of_gyros is not None:
            return self.of_gyros
        return self.truth

    def take(self, rows: Index) -> BoardMotion:
        """The motion at some of the instants, without what neighbours tell."""
        of_gyros = self.of_gyros and self.of_gyros.take(rows)
        return BoardMotion(self.truth.take(rows), self.context.take(rows), of_gyros)

    @property
    def age(self) -> Array | None:
        return self.context.covariates.get("sample_age")


def board_motion(
    *,
    imus: tuple[str, ...],
    rotations: Array,
    t: Array,
    order: Array | None = None,
    rate: Array | None = None,
    spin: Array | None = None,
    force: Array | None = None,
    jerk: Array | None = None,
    age: Array | None = None,
) -> BoardMotion:
    """From the board's axes; what is not given is zero.

    rotations : (K, 3, 3), package axes to board axes; t : (T,) s; order : (T,) 0..1 over the
    motion, by default in its middle; rate, spin : (T, 3) rad/s, rad/s²; force, jerk : (T, K, 3)
    m/s², m/s³; age : (T, K) or None
    """

    def turn_back(vector: Array | None) -> Array:
        if vector is None:
            return np.zeros((len(t), len(imus), 3))
        each = vector if vector.ndim == 3 else vector[:, None]
        return np.asarray((each[:, :, None] @ rotations)[:, :, 0])

    truth = Truth(turn_back(force), Motion(turn_back(rate), turn_back(spin), turn_back(jerk)))
    known = {"order": np.full(len(t), 0.5) if order is None else order, "time": t}
    context = Context(len(t), known, imus, attitude=rotations, moving=True)
    return BoardMotion(truth, context).set_ages(age)
