"""Figures that several calibrators show: what a search is worth, and a map of attitudes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.report.render.document import Plot, Series
from imucalib.report.render.svg import nice_step

#: Radius of a hemisphere of the unit sphere, Lambert's azimuthal equal-area projection (Snyder, Map
#: Projections: A Working Manual, USGS 1395, 1987, p. 185), and the gap between the two.
_RIM, _APART = float(np.sqrt(2.0)), 3.1
_CIRCLES = (0.0, 30.0, 60.0)  # deg over the map's rim


def band(label: str, x: Array, half: float, level: float = 0.0) -> Series:
    """From end to end of x (n,), `half` about a level."""
    ends = np.array([np.nanmin(x), np.nanmax(x)])
    return Series.from_half(label, ends, np.full(2, level), np.full(2, half), "band")


def sphere_map(
    direction: Array,
    error: Array,
    caption: str,
    *,
    names: Sequence[str] = (),
    poor: Array | None = None,
    poor_words: str = "",
) -> Plot:
    """Both hemispheres side by side, +z in the middle of the first one.

    direction : (n, 3), of gravity in the sensor's axes; error : (n,) mg, its size is shown in three
    bands; poor : (m, 3) directions in which the calibration is poorly known
    """
    x, y = project(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    size = np.abs(error)
    low = nice_step(max(float(np.nanmedian(size)), 1e-9), 1)
    bands = (
        (-1.0, low, f"below {low:g} mg"),
        (low, 3 * low, f"{low:g} to {3 * low:g} mg"),
        (3 * low, np.inf, f"above {3 * low:g} mg"),
    )
    series = [_net()]
    if poor is not None and len(poor):
        series.append(Series(poor_words, *project(poor), "points"))
    for least, most, words in bands:
        inside = (size > least) & (size <= most)
        own = tuple(n for n, keep in zip(names, inside, strict=True) if keep) if names else ()
        if inside.any():
            series.append(Series(words, x[inside], y[inside], "points", names=own))
    label = "gravity along +z (left) and -z (right); x to the right, y up"
    title = "Attitudes seen and the error left"
    return Plot(title, label, "", tuple(series), caption, equal=True, bare=True)


def project(direction: Array) -> tuple[Array, Array]:
    """Map coordinates (n,), (n,) of unit vectors (n, 3)."""
    up = direction[:, 2] >= 0.0
    scale = np.sqrt(2.0 / (1.0 + np.abs(direction[:, 2])))
    shift = np.where(up, -_APART / 2.0, _APART / 2.0)
    return scale * direction[:, 0] + shift, scale * direction[:, 1]


def _net() -> Series:
    """Rims, circles of equal elevation and the axes, as one line with gaps."""
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    gap = np.full((1, 2), np.nan)
    rays = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    radii = _RIM * np.sqrt(1.0 - np.sin(np.radians(_CIRCLES)))
    one = [np.concatenate([r * rays, gap]) for r in radii]
    one += [np.array([-axis, axis, [np.nan, np.nan]]) * _RIM for axis in np.eye(2)]
    net, shift = np.concatenate(one), np.array([_APART / 2.0, 0.0])
    both = np.concatenate([net - shift, net + shift])
    return Series("every 30 deg", both[:, 0], both[:, 1], "net")
