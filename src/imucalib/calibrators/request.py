"""What every calibrator can be asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from imucalib.calibration.findings import Findings, findings_of_fit
from imucalib.core.effect import Context, Effect
from imucalib.effects import named, own_effects
from imucalib.errors import UsageError
from imucalib.posterior.closed_loop.found import FitLoop
from imucalib.units import STANDARD_GRAVITY

#: Relative sd of gravity, by where its value comes from: anywhere on Earth (9.78 to 9.83 m/s²); of
#: a formula for the latitude (anomalies of some 50 mGal); as a user gives it, to a few digits.
_ANYWHERE, _BY_LATITUDE, _GIVEN = 1.3e-3, 5e-5, 1e-4


@dataclass(frozen=True, kw_only=True)
class Request:
    """Choices that all calibrators have.

    gravity : m/s², of the place; gravity_source : how it is known, in words
    declare : effects of the base model beyond the usual ones; only, without : restrict the search
    loop : whether there is a search; curves : whether structure without a name is corrected
    extra_effects : of the user's own files; limits : name -> largest allowed value
    command : the line that was typed, for the provenance
    """

    gravity: float = STANDARD_GRAVITY
    gravity_source: str = "standard gravity (give --gravity or --latitude for the local value)"
    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    loop: bool = True
    curves: bool = True
    extra_effects: Mapping[str, Effect] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    command: str = ""

    @property
    def gravity_assumed(self) -> bool:
        """Whether nobody said what gravity is at the place."""
        return self.gravity_source.startswith("standard")

    @property
    def gravity_sd(self) -> float:
        """Relative standard deviation of gravity by where its value comes from."""
        if self.gravity_assumed:
            return _ANYWHERE
        return _BY_LATITUDE if self.gravity_source.startswith("normal") else _GIVEN

    def describe_settings(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "gravity_m_per_s2": self.gravity,
            "gravity_source": self.gravity_source,
            "declare": list(self.declare),
            "only": list(self.only),
            "without": list(self.without),
            "own_effects": own_effects(self.extra_effects),
            "loop": self.loop,
            "curves": self.curves,
            "limits": dict(self.limits),
        }

    def select_declared(self, context: Context) -> tuple[Effect, ...]:
        """Effects that are in the base model as declared. Raises UsageError for an unknown one, and
        for one whose covariates were not recorded."""
        found = tuple(self.extra_effects.get(name) or named(name) for name in self.declare)
        for effect in found:
            if reason := effect.missing(context):
                raise UsageError(f"--declare {effect.name}: {reason}", remedy=effect.identify)
        return found

    def findings(self, loop: FitLoop | None) -> Findings | None:
        """What a search found, or None where there was none."""
        if loop is None:
            return None
        return findings_of_fit(loop, declared=self.declare, only=self.only, without=self.without)
