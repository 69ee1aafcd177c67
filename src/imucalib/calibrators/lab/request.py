"""What a user asks of `lab` about the input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.repairs import Repairs
from imucalib.effects import own_effects
from imucalib.rests.stillness import StillSettings
from imucalib.units import MG, STANDARD_GRAVITY


@dataclass(frozen=True)
class LabRequest:
    """Everything that the user chose about the input; `settings` is about the calibration.

    fixes : (row from 1, column role, value in the table's unit); exclude : rows from 1
    train : rows from 1 to choose and fit on; still : what counts as a rest
    limits : name -> largest allowed value; command : the line that was typed, for the provenance
    """

    unit: str | None = None
    lsb_per_g: float | None = None
    gravity: float = STANDARD_GRAVITY
    gravity_source: str = "standard gravity (give --gravity or --latitude for the local value)"
    reference: str = "vector"
    fixes: tuple[tuple[int, str, float], ...] = ()
    repairs: Repairs = field(default_factory=Repairs)
    exclude: tuple[int, ...] = ()
    auto_exclude: bool = False
    swap_angles: bool = False
    keep_angles: bool = False
    train: tuple[int, ...] = ()
    still: StillSettings = field(default_factory=StillSettings)
    limits: Mapping[str, float] = field(default_factory=dict)
    settings: LabSettings = field(default_factory=LabSettings)
    seed: int = 0
    command: str = ""

    def stated(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        settings = self.settings
        return {
            "reference": self.reference,
            "model": settings.model,
            "objective": settings.objective,
            "declare": list(settings.declare),
            "only": list(settings.only),
            "without": list(settings.without),
            "own_effects": own_effects(settings.extra_effects),
            "fleet_sha256": settings.population.sha256 if settings.population else None,
            "loop": settings.loop,
            "curves": settings.curves,
            "sigma_mg": None if settings.sigma is None else settings.sigma / MG,
            "lsb_per_g": self.lsb_per_g,
            "gravity_m_per_s2": self.gravity,
            "gravity_source": self.gravity_source,
            "conventions": asdict(settings.conventions),
            "fix": [f"{row}:{role}={value!r}" for row, role, value in self.fixes],
            "repairs": {k: v for k, v in asdict(self.repairs).items() if v},
            "exclude": list(self.exclude),
            "auto_exclude": self.auto_exclude,
            "train": list(self.train),
            "swap_angles": self.swap_angles,
            "keep_angles": self.keep_angles,
            "shortest_rest_s": self.still.shortest,
            "limits": dict(self.limits),
        }


def as_published(request: LabRequest) -> LabRequest:
    """Paper 004's own method, as found from its printed Table 2: objective (5) on rows 1-20, the
    12-parameter model, g = 9.80610 m/s², no search. No x-aligned row is among the first 20."""
    settings = replace(request.settings, model="linear12", objective="paper", loop=False)
    return replace(
        request,
        settings=settings,
        train=tuple(range(1, 21)),
        gravity=9.80610,
        gravity_source="as the paper used it",
    )
