"""What a user asks of `imu`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.request import Request
from imucalib.core.effect import Effect, Response
from imucalib.effects import catalogue
from imucalib.recording.mapping import UNCHANGED, AxisMap
from imucalib.rests.stillness import StillSettings


@dataclass(frozen=True, kw_only=True)
class ImuRequest(Request):
    """Everything that the user chose; see `Request` for what all calibrators have.

    gyro_axes : columns of the recording's rate that are the gyroscope's x, y, z; still : what
    counts as a rest
    """

    gyro_axes: AxisMap = UNCHANGED
    still: StillSettings = field(default_factory=StillSettings)

    def describe_settings(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            **super().describe_settings(),
            "gyro_axes": [list(self.gyro_axes.order), list(self.gyro_axes.sign)],
            "shortest_rest_s": self.still.shortest,
        }

    @property
    def of_rests(self) -> LabRequest:
        """The same of the accelerometer's bench of rests, from which a wrong one is left out as a
        turn is: nobody set it by hand."""
        shared = {one.name: getattr(self, one.name) for one in fields(Request)}
        gyro = gyro_effects(self.extra_effects)
        shared["declare"] = tuple(n for n in self.declare if n not in gyro)
        shared["limits"] = {}
        return LabRequest(
            **shared, reference="norm", still=self.still, partial=True, auto_exclude=True
        )


def gyro_effects(own: Mapping[str, Effect]) -> dict[str, Response]:
    """Effects of a gyroscope that no delay is part of: turns from rest to rest show none. own : of
    the user"""
    return {
        name: effect
        for name, effect in {**catalogue(), **own}.items()
        if isinstance(effect, Response) and effect.channel == "angular_rate" and not effect.lagged
    }
