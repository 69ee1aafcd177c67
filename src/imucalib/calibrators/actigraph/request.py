"""What a user asks of `actigraph`."""

from __future__ import annotations

from dataclasses import dataclass

from imucalib.calibrators.population import Population
from imucalib.calibrators.request import Request


@dataclass(frozen=True, kw_only=True)
class ActigraphRequest(Request):
    """Everything that the user chose; see `Request` for what all calibrators have. The field takes
    every place's gravity as 1 g, and so does the default.

    window : s, of the windows that are tested for rest
    as_published : the paper's own stillness rule, points and gradient descent
    arithmetic : of the gradient descent: "float", "int32" or "int16"
    every : s, length of the parts that are calibrated each on its own, or None
    blocks : contiguous stretches of time that are left out in turn to measure the error
    kind : what a fleet says of the device, for postures that leave parameters open
    """

    window: float = 10.0
    as_published: bool = False
    arithmetic: str = "float"
    blocks: int = 12
    every: float | None = None
    kind: Population | None = None

    def describe_settings(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "window_s": self.window,
            "every_s": self.every,
            "as_published": self.as_published,
            "arithmetic": self.arithmetic,
            **super().describe_settings(),
            "blocks": self.blocks,
            "fleet_sha256": self.kind.sha256 if self.kind else None,
        }
