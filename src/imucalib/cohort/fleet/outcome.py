"""A finished fleet: what its devices share, what each is by itself, what the next one will be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.provenance import Provenance
from imucalib.calibrators.population import Population
from imucalib.cohort.fleet.search import Search
from imucalib.cohort.fleet.spread import Outlier, Spread
from imucalib.loop.held_out import Difference


@dataclass(frozen=True)
class Recording:
    """One recording of a device. calibration : with the fleet's effects, or None where its file
    was not at hand; kept : why the fleet's effects are not in it, or empty"""

    name: str
    provenance: Provenance
    calibration: Calibration | None
    kept: str = ""


@dataclass(frozen=True)
class Member:
    """A device of the fleet. base, final : error without and with what the others say, mg, NaN
    where not computed; told : effects that the others find without it, which `final` stands on"""

    name: str
    recordings: tuple[Recording, ...]
    base: float
    final: float
    told: tuple[str, ...] = ()


@dataclass(frozen=True)
class Asked:
    """calibrator : of every device; command : that was typed; settings : as provenance has them"""

    calibrator: str
    command: str
    seed: int
    settings: Mapping[str, object]


@dataclass(frozen=True)
class Fleet:
    """members : in the order given; failed : file -> why it is no member; search : None where no
    recording holds what a search needs
    difference : held-out error over all members, mg, None where nothing was found
    following : what it says of the next device, None for fewer than four
    notes : what else a reader must know"""

    members: tuple[Member, ...]
    failed: tuple[tuple[str, str], ...]
    search: Search | None
    spreads: tuple[Spread, ...]
    outliers: tuple[Outlier, ...]
    difference: Difference | None
    asked: Asked
    following: Population | None = None
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """ "explained", "suspected", "unexplained", "nothing found" or "not searched"."""
        if self.search is None:
            return "not searched"
        if not self.search.found:
            return "unexplained" if self.search.refused else "nothing found"
        proved = self.difference is not None and self.difference.proved
        return "explained" if proved else "suspected"

    @property
    def exit_code(self) -> int:
        """5 where something is left open: a suspicion, an outlying device, a file that failed."""
        open_ = self.verdict in ("suspected", "unexplained") or self.outliers or self.failed
        return 5 if open_ else 0
