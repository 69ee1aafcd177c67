"""Rests of an IMU, and the turns between them that can be used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.estimators.carried import shares


@dataclass(frozen=True)
class Turn:
    """The samples of a turn, from inside rest `rest` to inside the next one.

    t : (n,) s; rate : (n, 3) rad/s, force : (n, 3) g, as read at t
    moving : (n,) share of a rate beside the bias that is motion: one in the turn, less at rest
    """

    rest: int
    t: Array
    rate: Array
    force: Array
    moving: Array

    @property
    def lasting(self) -> float:
        """s that it is in motion."""
        return float(shares(self.t) @ self.moving)


@dataclass(frozen=True)
class TurnLog:
    """N rests and the turns between them that can be used.

    time : (N,) s; force : (N, 3) g and rate : (N, 3) rad/s, means as read; force_sd : (N,) g and
    rate_sd : (N, 3) rad/s of these means; session : (N,) number of the power-up, from 0; white :
    rad/s √s, noise density of the gyroscope

    A rest that takes no part has an infinite force_sd.
    """

    time: Array
    force: Array
    rate: Array
    force_sd: Array
    rate_sd: Array
    session: Index
    turns: tuple[Turn, ...]
    white: float

    @property
    def rests(self) -> int:
        return len(self.time)

    @property
    def sessions(self) -> int:
        """Power-ups that have a part of their own: none where there is one alone."""
        count = int(self.session[-1]) + 1
        return count if count > 1 else 0

    @property
    def linked(self) -> Flags:
        """(N - 1,) whether the bias walks from a rest to the next one, or is another power-up's."""
        return np.asarray(np.diff(self.session) == 0)

    @cached_property
    def spans(self) -> Array:
        """(3, T) of every turn: s that count for what is steady, and for white noise; rad, the path
        in all."""
        found = np.empty((3, len(self.turns)))
        for k, turn in enumerate(self.turns):
            h, (seen, _) = shares(turn.t), remove_bias(self, self.rate, turn)
            found[:, k] = h @ np.stack(
                [turn.moving, turn.moving**2, np.linalg.norm(seen, axis=1)], axis=1
            )
        return found

    def without(self, rests: Flags) -> TurnLog:
        """With what the accelerometer reads at some rests (N,) said to be worth nothing."""
        return replace(self, force_sd=np.where(rests, np.inf, self.force_sd))

    def of_session(self, k: int) -> TurnLog:
        """One power-up by itself."""
        at = np.flatnonzero(self.session == k)
        own = (turn for turn in self.turns if self.session[turn.rest] == k)
        each = ("time", "force", "rate", "force_sd", "rate_sd")
        return replace(
            self,
            **{name: getattr(self, name)[at] for name in each},
            session=np.zeros(at.size, np.intp),
            turns=tuple(replace(turn, rest=turn.rest - int(at[0])) for turn in own),
        )


def remove_bias(log: TurnLog, drift: Array, turn: Turn) -> tuple[Array, Array]:
    """(n, 3) rad/s along a turn, as read without the bias, and the share (n,) of the bias there
    that is of the rest which ends it."""
    k = turn.rest
    share = (turn.t - log.time[k]) / (log.time[k + 1] - log.time[k])
    bias = drift[k] + share[:, None] * (drift[k + 1] - drift[k])
    return turn.moving[:, None] * (turn.rate - bias), share
