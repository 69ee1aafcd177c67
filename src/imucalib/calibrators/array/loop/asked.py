"""What the user declares of an array's effects, or keeps out of its search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.core.effect import Response
from imucalib.errors import UsageError


def named_effect(name: str, imus: Sequence[str]) -> tuple[Response, int | None]:
    """The effect and the one IMU that a name such as "gyro_scale@imu3" means.

    Raises UsageError for an unknown effect or IMU.
    """
    family, at, imu = name.partition("@")
    catalogue = array_catalogue()
    if family not in catalogue:
        raise UsageError(
            f"no array effect is called '{family}'", remedy="`imucal effects` lists them"
        )
    effect = catalogue[family]
    if not at:
        return effect, None
    if effect.shared or imu not in imus:
        reason = "acts on all IMUs alike" if effect.shared else f"has no IMU '{imu}' to act on"
        raise UsageError(f"'{name}': {family} {reason}", remedy=f"IMUs: {', '.join(imus)}")
    return effect, list(imus).index(imu)


@dataclass(frozen=True)
class Asked:
    """Names of effects, of one IMU with "@imu3". declare : in the model from the start; only : the
    search tries no others; without : it does not try these; search : whether there is one"""

    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    search: bool = True

    def skipped(self, imus: Sequence[str]) -> frozenset[str]:
        """All effects that the search shall not try. Raises UsageError for an unknown name."""
        for name in (*self.only, *self.without):
            named_effect(name, imus)
        every = {
            name
            for effect in array_catalogue().values()
            for name in (effect.name, *(f"{effect.name}@{imu}" for imu in imus))
        }
        if not self.search:
            return frozenset(every)

        def meant(name: str, chosen: Sequence[str]) -> bool:
            return name in chosen or name.partition("@")[0] in chosen

        return frozenset(
            n for n in every if meant(n, self.without) or (self.only and not meant(n, self.only))
        )


NOTHING_ASKED = Asked()
