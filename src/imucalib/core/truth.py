"""What sensors are exposed to: specific force, and in an array the motion."""

from __future__ import annotations

from dataclasses import dataclass

from imucalib.arrays import Array, Index


@dataclass(frozen=True)
class Motion:
    """How K triads turn: rate ω (rad/s), spin dω/dt (rad/s²) and jerk, the specific force's
    derivative (m/s³), each (n, K, 3) in every triad's own axes."""

    rate: Array
    spin: Array
    jerk: Array

    def take(self, rows: Index) -> Motion:
        return Motion(self.rate[rows], self.spin[rows], self.jerk[rows])


@dataclass(frozen=True)
class Truth:
    """What K triads are exposed to in n observations, each triad in its own axes.

    force : (n, K, 3) m/s², specific force; motion : None where the sensors rest
    """

    force: Array
    motion: Motion | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, K, 3)."""
        return self.force.shape

    def take(self, rows: Index) -> Truth:
        return Truth(self.force[rows], self.motion and self.motion.take(rows))

    @property
    def turning(self) -> Motion:
        """The motion. Raises ValueError at rest: an effect that asks for it must name it in
        `needs`."""
        if self.motion is None:
            raise ValueError("the sensors rest: there is no motion")
        return self.motion
