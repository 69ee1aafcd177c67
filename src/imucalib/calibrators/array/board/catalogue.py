"""Effects of an array, and which of them the user keeps out of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucalib.calibrators.request import Request
from imucalib.core.effect import Response
from imucalib.effects import catalogue
from imucalib.errors import UsageError

#: Typical sizes of what the rests have calibrated already, each in its own unit.
_AFTER_RESTS = {
    "scale": 2e-3,
    "bias": 2.0,
    "quadratic": 0.3,
    "cubic": 0.02,
    "asymmetry": 2.0,
    "cross_axis": 0.3,
    "bias_drift": 2.0,
    "scale_drift": 2.0,
    "warm_up": 2.0,
}
#: How a name begins that speaks of the rests alone.
AT_REST = "at rest: "
#: Effects that are a part of others, which are tried.
_WITHIN = ("non_orthogonality",)


def array_catalogue() -> dict[str, Response]:
    """Every effect of the catalogue that acts on a sensor and is linear in its parameters, at the
    size that the rests leave of it, tried on each IMU alone too: what one IMU does is no error of
    all."""
    return {
        name: _set_size(effect)
        for name, effect in catalogue().items()
        if isinstance(effect, Response) and name not in _WITHIN
    }


def _set_size(effect: Response) -> Response:
    typical = _AFTER_RESTS.get(effect.name)
    each = [p if typical is None else replace(p, typical=typical) for p in effect.each]
    return replace(effect, each=tuple(each), scan=not effect.shared)


def twins_of(name: str) -> tuple[str, ...]:
    """Effects of the same IMUs whose columns are those of the named one: in a search one is there
    for all, and a refit tells them apart."""
    family, at, imu = name.partition("@")
    effects = array_catalogue()
    if family not in effects:
        return ()
    first = effects[family].twin or family
    twins = (n for n, e in effects.items() if first in (n, e.twin) and n != family)
    return tuple(f"{n}{at}{imu}" for n in twins)


def find_effect(name: str, imus: Sequence[str]) -> Response:
    """The effect that a name means, such as "gyro_scale@imu3" of one IMU.

    Raises UsageError for an unknown effect or IMU.
    """
    family, at, imu = name.partition("@")
    effect = array_catalogue().get(family)
    if effect is None:
        raise UsageError(
            f"no array effect is called '{family}'", remedy="`imucal effects` lists them"
        )
    if at and (effect.shared or imu not in imus):
        reason = "acts on all IMUs alike" if effect.shared else f"has no IMU '{imu}' to act on"
        raise UsageError(f"'{name}': {family} {reason}", remedy=f"IMUs: {', '.join(imus)}")
    return effect


def find_skipped(request: Request, imus: Sequence[str]) -> frozenset[str]:
    """All effects that a search shall not try, those of one IMU with "@imu3". Raises UsageError for
    an unknown name."""
    only, without = request.only, request.without
    for name in (*only, *without):
        find_effect(name, imus)
    every = [n + end for n in array_catalogue() for end in ("", *(f"@{i}" for i in imus))]

    def is_meant(name: str, chosen: Sequence[str]) -> bool:
        return name in chosen or name.partition("@")[0] in chosen

    return frozenset(
        n
        for n in every
        if not request.loop or is_meant(n, without) or (only and not is_meant(n, only))
    )
