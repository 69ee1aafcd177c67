"""What a user asks of `actigraph`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from imucalib.calibrators.population import Population
from imucalib.core.effect import Effect
from imucalib.effects import own_effects
from imucalib.units import STANDARD_GRAVITY

#: Scans whose members may have any form: of an axis' response, of the temperature, of the posture.
FREE = ("converter", "curve", "posture")
#: Those of them that every posterior has beside its names.
HELD = ("converter", "curve")


@dataclass(frozen=True)
class ActigraphRequest:
    """Everything that the user chose.

    gravity : m/s²; the field takes every place's gravity as 1 g, and so does the default
    as_published : the paper's own stillness rule, points and gradient descent
    arithmetic : of the gradient descent: "float", "int32" or "int16"
    declare, only, without : effects of the base model, and of the search
    every : s, length of the parts that are calibrated each on its own, or None
    blocks : contiguous stretches of time that are left out in turn to measure the error
    kind : what a fleet says of the device, for postures that leave parameters open
    command : the line that was typed, for the provenance
    """

    gravity: float = STANDARD_GRAVITY
    gravity_source: str = "standard gravity; --gravity or --latitude gives the local value"
    triad: str | None = None
    window: float = 10.0
    as_published: bool = False
    arithmetic: str = "float"
    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    loop: bool = True
    curves: bool = True
    extra_effects: Mapping[str, Effect] = field(default_factory=dict)
    blocks: int = 12
    every: float | None = None
    limits: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    kind: Population | None = None
    command: str = ""

    def stated(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "window_s": self.window,
            "gravity_m_per_s2": self.gravity,
            "gravity_source": self.gravity_source,
            "triad": self.triad,
            "every_s": self.every,
            "as_published": self.as_published,
            "arithmetic": self.arithmetic,
            "declare": list(self.declare),
            "only": list(self.only),
            "without": list(self.without),
            "own_effects": own_effects(self.extra_effects),
            "loop": self.loop,
            "blocks": self.blocks,
            "curves": self.curves,
            "limits": dict(self.limits),
            "fleet_sha256": self.kind.sha256 if self.kind else None,
        }
