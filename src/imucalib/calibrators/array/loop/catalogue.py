"""The effects that an array is searched for, at the sizes that its rests leave of them."""

from __future__ import annotations

from dataclasses import replace

from imucalib.core.effect import Response
from imucalib.effects import catalogue

#: Typical sizes of what the rests have calibrated already, each in its own unit.
_LEFT_BY_RESTS = {
    "scale": 2e-3, "bias": 2.0, "quadratic": 0.3, "cubic": 0.02, "asymmetry": 2.0,
    "cross_axis": 0.3, "bias_drift": 2.0, "scale_drift": 2.0, "warm_up": 2.0,
}  # fmt: skip
#: Effects that are a part of others, which are tried.
_WITHIN = ("non_orthogonality",)


def array_catalogue() -> dict[str, Response]:
    """Every effect of the catalogue that acts on a sensor and is linear in its parameters."""
    return {name: sized(effect) for name, effect in _linear().items()}


def _linear() -> dict[str, Response]:
    return {
        name: effect
        for name, effect in catalogue().items()
        if isinstance(effect, Response) and name not in _WITHIN
    }


def twins_of(name: str) -> tuple[str, ...]:
    """Effects of the same IMUs whose columns are those of the named one: in a search one stands for
    all, and a refit tells them apart."""
    family, at, imu = name.partition("@")
    effects = _linear()
    if family not in effects:
        return ()
    one = effects[family].twin or family
    alike = (n for n, e in effects.items() if one in (n, e.twin) and n != family)
    return tuple(f"{n}{at}{imu}" for n in alike)


def sized(effect: Response) -> Response:
    """An effect at the size that the rests leave of it, tried on each IMU alone too: what one IMU
    does is not to be told of all."""
    typical = _LEFT_BY_RESTS.get(effect.name)
    each = effect.each
    if typical is not None:
        each = tuple(replace(p, typical=typical) for p in each)
    return replace(effect, each=each, scan=not effect.shared)
