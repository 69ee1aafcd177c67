"""Errors of the positions against what drives them, before and after, with the noise band."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.uncertainty import angle_uncertainty
from imucalib.calibrators.lab.attitude import AttitudeErrors, attitude_errors, rms
from imucalib.calibrators.lab.bench import row_numbers
from imucalib.calibrators.lab.calibrate import gravity_of
from imucalib.calibrators.lab.errors import reading_noise, setting_noise
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector, angles_of
from imucalib.effects import known
from imucalib.effects.covariate import COLUMN
from imucalib.loop.held_out import fitted
from imucalib.report.document import Plot, Series
from imucalib.report.sphere import sphere_map
from imucalib.units import DEG, MG

#: Words in the name of an effect and the quantity that drives it.
_DRIVERS = (
    ("inclination", "inclination"), ("tool_face", "tool-face"), ("temperature", "temperature"),
    ("thermal", "temperature"), ("drift", "row"), ("step", "row"), ("warm", "row"),
)  # fmt: skip


def residual_plots(run: LabRun) -> tuple[Plot, ...]:
    """The quantity that gained most against every driver of what was found, the others by row."""
    before, after, left_out = _errors(run)
    quantities = [("|a|", "mg", before.norm, after.norm, _bands(run)["norm"])]
    if isinstance(run.result.observations.reference, KnownVector):
        quantities += [
            ("inclination", "deg", before.inclination, after.inclination, _bands(run)["incl"]),
            ("tool-face", "deg", before.tool_face, after.tool_face, _bands(run)["tf"]),
        ]
    quantities.sort(key=lambda q: rms(q[3]) / max(rms(q[2]), 1e-12))
    axes, drivers = _axes(run), _drivers(run)
    wanted = [(quantities[0], name) for name in drivers if name in axes]
    wanted += [(q, "row") for q in quantities if (q, "row") not in wanted]
    caption = "Each row predicted without it" if left_out else "The fitted rows"
    return tuple(
        _plot(run, quantity, name, axes[name], f"{caption}, before and after the search.")
        for quantity, name in wanted
    )


def _errors(run: LabRun) -> tuple[AttitudeErrors, AttitudeErrors, bool]:
    """Before and after of the used rows, held out where each of them was; and whether they were."""
    every = [s for s in run.result.splits if len(s.rows) == len(run.result.used)]
    held = every[-1] if every else None
    base, final = (
        (held.base, held.final) if held else (fitted(run.result.base), fitted(run.result.final))
    )
    meant = run.request.settings.conventions
    return attitude_errors(base, meant), attitude_errors(final, meant), held is not None


def _plot(
    run: LabRun, quantity: tuple[str, str, Array, Array, float], name: str, x: Array, caption: str
) -> Plot:
    what, unit, old, new, half = quantity
    names = run.result.final.observations.label
    ends = np.array([np.nanmin(x), np.nanmax(x)])
    zero = np.zeros(2)
    series = [
        Series("noise and setting, ± 2 sd", ends, zero, "band", zero - half,
               zero + half),
        Series("before", x, old, "points", names=names),
        Series("after", x, new, "points", names=names),
    ]  # fmt: skip
    at = _suspects(run)
    if at.size:
        series.append(Series("wrong record", x[at], old[at], "rings"))
    other = " (g)" if len(name) == 1 else "" if name.startswith(COLUMN) else " (deg)"
    unit_of_x = {"row": "", "temperature": " (°C)"}.get(name, other)
    return Plot(
        f"Error of {what} against {name}", f"{name}{unit_of_x}", f"error of {what} ({unit})",
        tuple(series), caption,
    )  # fmt: skip


def _suspects(run: LabRun) -> Index:
    """Which of the used rows do not belong to the rest, by the search or by a slip of hand."""
    found = [r.row for r in run.result.loop.records] if run.result.loop else []
    slips = [row for fault in run.faults.slips for row in fault.rows]
    named = np.isin(row_numbers(run.result.final.observations), slips)
    return np.union1d(np.array(found, np.intp), np.flatnonzero(named))


def _axes(run: LabRun) -> dict[str, Array]:
    """What can drive an error, (n,) of each used row."""
    data = run.result.final.observations
    found = {"row": row_numbers(data).astype(np.float64)}
    reading = data.reading[:, 0] / gravity_of(run.result.observations)
    found |= {axis: reading[:, k] for k, axis in enumerate("xyz")}
    if isinstance(data.reference, KnownVector):
        angles = angles_of(fitted(run.result.final).expected[:, 0])
        inclination, tool_face = run.request.settings.conventions.outside(*angles)
        found |= {"inclination": inclination, "tool-face": tool_face}
    beside = data.context.covariates
    shown = (name for name in beside if name == "temperature" or name.startswith(COLUMN))
    return found | {name: beside[name] for name in shown}


def _driven(effect: str) -> tuple[str, ...]:
    """What drives an effect; a column that it follows has its needs alone."""
    own = known(effect) if effect.startswith("follows@") else None
    return own.needs if own else tuple(d for word, d in _DRIVERS if word in effect)


def _drivers(run: LabRun) -> tuple[str, ...]:
    """What drives the effects that were found, or what stays, first found first."""
    loop = run.result.loop
    effects = [s.effect for s in loop.steps] if loop else []
    named = [d for e in effects for d in _driven(e)]
    # A sensor's own curve acts on the axis: all three are shown.
    own = [a for e in effects if not _driven(e) for a in "xyz"]
    left = [u.driver for u in loop.unexplained] if loop else []
    return tuple(dict.fromkeys((*named, *own, *left)))


def _bands(run: LabRun) -> dict[str, float]:
    """Two standard deviations of a reading's noise and of a setting, mg and deg."""
    fit = run.result.final
    sigma = reading_noise(fit).whole
    bands = {"norm": 2.0 * sigma / MG}
    if isinstance(fit.observations.reference, KnownVector):
        i, t = angles_of(fitted(fit).expected[:, 0])
        found = angle_uncertainty(fit, i, t, run.request.gravity, sigma)
        settings = setting_noise(fit)
        for key, name, own in (
            ("incl", "inclination", found.inclination_reading),
            ("tf", "tool-face", found.tool_face_reading),
        ):
            set_sd = next((v for n, v in settings.items() if n.startswith(name)), 0.0) / DEG
            bands[key] = 2.0 * float(np.hypot(np.median(own), set_sd))
    return bands


def attitude_map(run: LabRun) -> Plot:
    """Attitudes that were seen and the error left at each."""
    data, gravity = run.result.final.observations, gravity_of(run.result.observations)
    every = [s for s in run.result.splits if len(s.rows) == len(run.result.used)]
    held = every[-1].final if every else fitted(run.result.final)
    error = np.linalg.norm(held.error[:, 0], axis=-1) / MG
    caption = (
        "Equal areas of the map are equal parts of the sphere. "
        + ("Each row predicted without it." if every else "The fitted rows.")
        + f" Local gravity {gravity:.4f} m/s²."
    )
    return sphere_map(
        "Attitudes seen and the error left", held.expected[:, 0], error, "mg", caption,
        names=data.label,
    )  # fmt: skip
