"""What a user asks of `lab`."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Literal

from imucalib.calibrators.lab.repairs import Repairs
from imucalib.calibrators.population import Population
from imucalib.calibrators.request import Request
from imucalib.core.angle_conventions import Conventions
from imucalib.rests.stillness import StillSettings
from imucalib.units import MG

Objective = Literal["settings", "vector", "angles", "paper"]


@dataclass(frozen=True, kw_only=True)
class LabRequest(Request):
    """Everything that the user chose; see `Request` for what all calibrators have.

    unit, lsb_per_g : of the readings, or None to find it; reference : "vector", "direction", "norm"
    model : "linear12" (paper 004, model 3) or "geometric9" (model 4)
    objective : "settings" (errors in variables, the default), "vector" (angles taken as exact),
        "angles" (the paper's suggestion for steep inclinations), "paper" (its objective 5)
    fixes : (row from 1, column role, value in the table's unit); exclude : rows from 1
    train : rows from 1 to choose and fit on, the rest is the test set
    trust : rows from 1 that stand as they were set, where the readings do not say which part does
    sigma : declared noise of a reading, m/s², or None to take it from the data
    still : what counts as a rest
    partial : whether positions may leave something open, which other data close
    population : what a fleet says of the device: its effects are in the base model, and there is no
        search beside a prior
    """

    unit: str | None = None
    lsb_per_g: float | None = None
    reference: str = "vector"
    model: str = "linear12"
    objective: Objective = "settings"
    conventions: Conventions = field(default_factory=Conventions)
    fixes: tuple[tuple[int, str, float], ...] = ()
    repairs: Repairs = field(default_factory=Repairs)
    exclude: tuple[int, ...] = ()
    auto_exclude: bool = False
    swap_angles: bool = False
    keep_angles: bool = False
    train: tuple[int, ...] = ()
    trust: tuple[int, ...] = ()
    sigma: float | None = None
    still: StillSettings = field(default_factory=StillSettings)
    population: Population | None = None
    partial: bool = False

    def describe_settings(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "reference": self.reference,
            "model": self.model,
            "objective": self.objective,
            **super().describe_settings(),
            "fleet_sha256": self.population.sha256 if self.population else None,
            "sigma_mg": None if self.sigma is None else self.sigma / MG,
            "lsb_per_g": self.lsb_per_g,
            "conventions": asdict(self.conventions),
            "fix": [f"{row}:{role}={value!r}" for row, role, value in self.fixes],
            "repairs": {k: v for k, v in asdict(self.repairs).items() if v},
            "exclude": list(self.exclude),
            "auto_exclude": self.auto_exclude,
            "train": list(self.train),
            "trust": list(self.trust),
            "swap_angles": self.swap_angles,
            "keep_angles": self.keep_angles,
            "shortest_rest_s": self.still.shortest,
        }


def as_published(request: LabRequest) -> LabRequest:
    """Paper 004's own method, as found from its printed Table 2: objective (5) on rows 1-20, the
    12-parameter model, g = 9.80610 m/s², no search. No x-aligned row is among the first 20."""
    return replace(
        request,
        model="linear12",
        objective="paper",
        loop=False,
        train=tuple(range(1, 21)),
        gravity=9.80610,
        gravity_source="as the paper used it",
    )
