"""What a user asks of `imucal array`."""

from __future__ import annotations

from dataclasses import dataclass, field

from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.motion.total import Distance
from imucalib.calibrators.request import Request
from imucalib.errors import UsageError
from imucalib.estimators.markov import Stop
from imucalib.rests.stillness import StillSettings


@dataclass(frozen=True)
class Accepted:
    """What a user lets pass unexplained: mm of a position, mg and deg/s of a residual in motion
    beyond the noise at rest."""

    mm: float = 0.05
    mg: float = 50.0
    deg_per_s: float = 2.0


@dataclass(frozen=True, kw_only=True)
class ArrayRequest(Request):
    """as_published : positions by the procedure of paper 001, without a search; iterations : of it
    samples : moving samples used at most, or None for all that say something
    stop : when the chains are long enough
    still : what counts as a rest
    distances : between IMUs, measured otherwise; accepted : what may stay unexplained
    as_drawn : whether axes and places are those of the board file, whatever the log says
    agreeing : other logs that are calibrated along and agree with the board file"""

    board: Board
    as_published: bool = False
    iterations: int = 100_000
    samples: int | None = None
    stop: Stop = field(default_factory=Stop)
    still: StillSettings = field(default_factory=StillSettings)
    curves: bool = False
    distances: tuple[Distance, ...] = ()
    accepted: Accepted = field(default_factory=Accepted)
    as_drawn: bool = False
    agreeing: tuple[str, ...] = ()

    def refuse_contradictions(self) -> None:
        """Raise UsageError for choices that exclude each other."""
        if self.limits and not (self.loop or self.declare):
            raise UsageError("limits need held-out data", remedy="leave --no-loop out")
        if self.as_published and (self.declare or self.limits):
            raise UsageError(
                "the paper's procedure searches for nothing, holds nothing out and declares "
                "nothing",
                remedy="leave --as-published out",
            )

    def describe_settings(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "board": self.board.name,
            "as_published": self.as_published,
            "iterations": self.iterations,
            "samples": self.samples,
            "ess": self.stop.ess,
            "prior_sd_mm": 1e3 * self.board.prior_sd,
            **super().describe_settings(),
            "accepted": dict(vars(self.accepted)),
            "distances_mm": [
                [self.board.imus[d.one], self.board.imus[d.two], 1e3 * d.value, 1e3 * d.sd]
                for d in self.distances
            ],
            "as_drawn": self.as_drawn,
            "shortest_rest_s": self.still.shortest,
        }
