"""The numbers over which every form of `effects/shape` is scanned against its driver."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.loop.candidates import fitted_prediction
from imucalib.units import DEG, STANDARD_GRAVITY

_ANGLES = ("tool_face", "inclination")
_HARMONICS = 12


def forms_of(fit: Fit, kind: str, what: str, against: str) -> tuple[str, ...]:
    """Names of the forms of a kind that a scan beside a fit tries."""
    return tuple(
        _name(what, against, kind, numbers)
        for numbers in _numbers(kind, _driver(fit, what, against), what, against)
    )


def _name(what: str, against: str, kind: str, numbers: tuple[float, ...]) -> str:
    return f"shape@{what}:{against}:{kind}:" + ":".join(f"{v:.4g}" for v in numbers)


def _driver(fit: Fit, what: str, against: str) -> Array:
    """Sorted distinct values of the driver, in g or as the covariate is, angles in degrees."""
    if what == "response":
        force = fitted_prediction(fit).force / STANDARD_GRAVITY
        values = force[..., ["xyz".index(a) for a in against]]
    else:
        values = fit.observations.context[against] / (DEG if against in _ANGLES else 1.0)
    return np.unique(np.round(values, 9))


def _sines(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    if against == "tool_face":
        # Beyond half of the settings a harmonic reads as a slower one: that one is the simpler.
        most = min(_HARMONICS, max(1, len(np.unique(np.round(np.mod(u, 360.0), 6))) // 2))
        yield from ((360.0 / k,) for k in range(1, most + 1))
        return
    span = float(np.ptp(u))
    shortest = max(4.0 * span / u.size, span / 16.0)
    yield from ((float(p),) for p in np.geomspace(shortest, 1.5 * span, 32))


def _powers(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    middle, reach = 0.5 * float(u[0] + u[-1]), 0.5 * float(np.ptp(u))
    if what == "response":
        middle, reach = 0.0, 1.0
    # The square of a temperature has a name, and a turning point that is looked for.
    powers = (3, 4, 5) if against == "temperature" else (2, 3, 4, 5)
    yield from ((float(k), middle, reach) for k in powers)


def _inside(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    yield from ((float(v),) for v in np.linspace(u[0], u[-1], 18)[2:-2])


def _steps(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    between = 0.5 * (u[1:] + u[:-1])
    edge = max(1, between.size // 12)
    picked = np.unique(np.linspace(edge, between.size - 1 - edge, 24).astype(int))
    yield from ((float(v),) for v in between[picked])


def _limits(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    if what == "response":
        yield from ((float(v),) for v in (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9))


def _teeth(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    for (period,) in _sines(u, what, against):
        yield from ((period, float(phase)) for phase in np.arange(8) / 8.0)


def _decays(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    span = float(np.ptp(u))
    for share in (0.05, 0.1, 0.2, 0.4, 0.8):
        yield share * span, float(u[0])
        yield -share * span, float(u[-1])


_GRIDS = {
    "sine": _sines, "power": _powers, "kink": _inside, "step": _steps, "saturation": _limits,
    "soft_saturation": _limits, "saw_tooth": _teeth, "exponential": _decays,
}  # fmt: skip


def _numbers(kind: str, u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    return _GRIDS[kind](u, what, against) if u.size >= 8 else iter(())
