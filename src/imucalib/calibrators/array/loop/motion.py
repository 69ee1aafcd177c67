"""The fitted motion of a board as effects take it: every triad's truth in its own axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Channel
from imucalib.core.truth import Motion, Truth


@dataclass(frozen=True)
class BoardMotion:
    """The truth at T instants as K triads see it, and what is known beside it; of_gyros : the
    same for gyros, where they or the accelerometers are late; midway : at half that time, where
    what they lag behind by is what they lose in the whole of it"""

    truth: Truth
    context: Context
    of_gyros: Truth | None = None
    midway: BoardMotion | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(T, K)."""
        return self.context.n, len(self.context.triads)

    def turned(self, basis: Array) -> Array:
        """(K, T, 3, m) in board axes, of a basis (T, K, 3, m) in each package's."""
        attitude = self.context.attitude
        assert attitude is not None
        t, k, _, m = basis.shape
        out = np.empty((k, t, 3, m))
        # Mountings are mostly signed permutations: of nine products three are not zero.
        for triad, i in np.ndindex(k, 3):
            first, *others = np.flatnonzero(attitude[triad, i])
            np.multiply(basis[:, triad, first], attitude[triad, i, first], out=out[triad, :, i])
            for j in others:
                out[triad, :, i] += attitude[triad, i, j] * basis[:, triad, j]
        return out

    def aged(self, age: Array | None) -> BoardMotion:
        """With the (T, K) sawtooth ages of the gyros' readings, or without any."""
        rest = {k: v for k, v in self.context.covariates.items() if k != "sample_age"}
        known = rest if age is None else {**rest, "sample_age": age}
        context = replace(self.context, covariates=known)
        midway = None if self.midway is None else replace(self.midway, context=context)
        return replace(self, context=context, midway=midway)

    def late(self, late: tuple[Array, Array], bend: Array, sway: Array) -> BoardMotion:
        """As late sensors sense it: all that acts on a reading acts on what was then.

        late : (T, K) s of gyros and of accelerometers; bend : (T, 3) d²ω/dt², rad/s³; sway :
        (T, K, 3) second derivative of the forces, m/s⁴; both in board axes
        """
        attitude, shape = self.context.attitude, self.truth.shape
        assert attitude is not None
        bent, swayed = (
            np.matmul(np.broadcast_to(x, shape)[:, :, None], attitude)[:, :, 0]
            for x in (bend[:, None], sway)
        )
        whole, half = (
            [
                _earlier(self.truth, share * lag[..., None], bent, swayed) if lag.any()
                else self.truth for lag in late
            ]
            for share in (1.0, 0.5)
        )  # fmt: skip
        midway = replace(self, of_gyros=half[0], truth=half[1])
        return replace(self, of_gyros=whole[0], truth=whole[1], midway=midway)

    def truth_of(self, channel: Channel) -> Truth:
        """What the sensors of a kind are exposed to when they read."""
        if channel == "angular_rate" and self.of_gyros is not None:
            return self.of_gyros
        return self.truth

    @property
    def age(self) -> Array | None:
        return self.context.covariates.get("sample_age")


def _earlier(truth: Truth, by: Array, bend: Array, sway: Array) -> Truth:
    """The truth `by` (T, K, 1) s before, to the second order; bend, sway : (T, K, 3) as in
    `BoardMotion.late`, in each package's axes."""
    turning = truth.turning
    spin, jerk = turning.spin - by * bend, turning.jerk - by * sway
    rate = turning.rate - 0.5 * by * (turning.spin + spin)
    return Truth(truth.force - 0.5 * by * (turning.jerk + jerk), Motion(rate, spin, jerk))


def board_motion(
    *, imus: tuple[str, ...], rotations: Array, t: Array, order: Array, rate: Array, spin: Array,
    force: Array, jerk: Array, age: Array | None = None,
) -> BoardMotion:  # fmt: skip
    """From the board's axes.

    rotations : (K, 3, 3), package axes to board axes; t : (T,) s; order : (T,) 0..1 over the motion
    rate, spin : (T, 3) rad/s, rad/s²; force, jerk : (T, K, 3) m/s², m/s³; age : (T, K) or None
    """
    shape = (len(t), len(imus), 3)

    def seen(vector: Array) -> Array:
        whole = np.broadcast_to(vector[:, None] if vector.ndim == 2 else vector, shape)
        return np.asarray(np.matmul(whole[:, :, None], rotations)[:, :, 0])

    truth = Truth(seen(force), Motion(seen(rate), seen(spin), seen(jerk)))
    context = Context(len(t), {"order": order, "time": t}, imus, attitude=rotations, moving=True)
    return BoardMotion(truth, context).aged(age)


def motion_at_rest(imus: tuple[str, ...], rotations: Array, force: Array, t: Array) -> BoardMotion:
    """The board at rest under forces (n, K, 3) m/s² in board axes; t : (n,) s."""
    n, still = len(force), np.zeros((len(force), 3))
    return board_motion(
        imus=imus, rotations=rotations, t=t, order=np.full(n, 0.5), rate=still, spin=still,
        force=force, jerk=np.zeros_like(force),
    )  # fmt: skip
