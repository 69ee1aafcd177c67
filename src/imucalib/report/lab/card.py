"""What a bench's calibration is good to: errors on positions left out, angles at the worst
attitude."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.uncertainty import angle_uncertainty, force_slope
from imucalib.calibrators.lab.attitude import attitude_errors, rms, worst
from imucalib.calibrators.lab.errors import reading_noise
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector
from imucalib.core.sphere import covered, even_directions
from imucalib.report.card import card_of, error_worth, like_these
from imucalib.report.document import Card, Worth
from imucalib.units import DEG, MG

#: deg off the vertical, where it has no meaning, from which a tool-face is promised.
_FROM_VERTICAL = 30.0
_NORMAL_95 = 1.96


def lab_card(run: LabRun) -> Card:
    """The card of a bench."""
    reference = run.result.observations.reference
    known = isinstance(reference, KnownVector)
    directed = reference.directed
    metric = "vector" if known else run.outcome.error.metric.partition(",")[0]
    seen = covered(run.result.final.observations.reading[:, 0])
    first = error_worth(run.outcome.error, metric, "positions", like_these("attitudes", seen))
    good = (first, *([_worst(run)] if directed else []), *_next_power_up(run))
    return card_of(run.outcome, (*good, *(_angles(run) if known else ())))


def within_a_circle(half: float, most: float, places: int) -> str:
    """Half the width of an angle's interval, deg. most : deg that the angle can be off by at all,
    so that a wider interval says nothing of it."""
    return f"{half:.{places}f}" if half < most else "not determined"


def _next_power_up(run: LabRun) -> tuple[Worth, ...]:
    """How far what changes between sessions lets a calibration carry, by the worst axis."""
    if run.sessions is None:
        return ()
    count = len(run.sessions.names)
    worst_of = dict[str, Worth]()
    for p in sorted(run.sessions.parameters, key=lambda p: p.half):
        detail = f"95 %, worst axis, from {count} sessions; their mean ± {1.96 * p.mean:.2g}"
        worst_of[p.effect] = Worth(
            f"{p.effect} after a power-up", f"± {p.half:.2g} {p.unit}", detail
        )
    return tuple(worst_of.values())


def _worst(run: LabRun) -> Worth:
    """The corrected vector where the calibration knows it least."""
    fit, directions = run.result.final, even_directions()
    slope, _ = force_slope(fit, run.request.gravity * directions[:, None])
    variance = np.einsum("nip,pq,niq->n", slope, fit.covariance, slope)
    sd = np.sqrt(np.maximum(variance, 0.0)) / MG
    k = int(np.argmax(sd))
    towards = ", ".join(f"{a} {v:+.1f}" for a, v in zip("xyz", directions[k], strict=True))
    return Worth(
        "vector, worst attitude",
        f"± {1.96 * sd[k]:.2g} mg",
        f"95 %, calibration only, with gravity along {towards}; {1.96 * sd.mean():.2g} mg on "
        "average over all",
    )


def _angles(run: LabRun) -> tuple[Worth, ...]:
    """Of one corrected reading, 95 %, at the worst attitude; and on positions left out."""
    result, fit = run.result, run.result.final
    meant = run.request.settings.conventions
    i, t = (g.ravel() for g in np.meshgrid(np.arange(-85.0, 86.0, 5.0), np.arange(0, 360, 15.0)))
    sigma = reading_noise(fit).whole
    found = angle_uncertainty(fit, i * DEG, t * DEG, run.request.gravity, sigma)
    held = result.splits[-1] if result.splits else None
    left = attitude_errors(held.final, meant) if held else None
    every = np.ones(i.size, np.bool_)
    flat = np.abs(i) <= 90.0 - _FROM_VERTICAL
    shown = meant.outside(i * DEG, t * DEG)

    def worth(
        name: str, own: Array, reading: Array, used: Array, left_out: Array | None, most: float
    ) -> Worth:
        half = np.where(used, np.hypot(own, _NORMAL_95 * reading), 0.0)
        k = int(np.argmax(half))
        attitude = f"inclination {shown[0][k]:.0f}, tool-face {shown[1][k]:.0f} deg"
        where = "" if used.all() else f" {_FROM_VERTICAL:.0f} deg or more off the vertical"
        at = f"one reading, 95 %, worst attitude{where} ({attitude})"
        if left_out is not None:
            at += (
                f"; positions left out, with how they were set: {rms(left_out):.2f} rms, "
                f"{worst(left_out):.2f} largest"
            )
        width = within_a_circle(float(half[k]), most, 2)
        return Worth(name, f"± {width} deg" if half[k] < most else width, at)

    return (
        worth("inclination", found.inclination_95, found.inclination_reading, every,
              left.inclination if left else None, 90.0),
        worth("tool-face", found.tool_face_95,
              found.tool_face_reading, flat, left.tool_face if left else None, 180.0),
    )  # fmt: skip
