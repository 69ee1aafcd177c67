"""The report of `imucal lab`, as data."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.uncertainty import angle_uncertainty, force_slope
from imucalib.calibrators.lab.bench import row_numbers
from imucalib.calibrators.lab.calibrate import gravity_of
from imucalib.calibrators.lab.dial import bends, dial_of, dial_words
from imucalib.calibrators.lab.errors import (
    AttitudeErrors,
    attitude_errors,
    reading_noise,
    rms,
    setting_noise,
    worst,
)
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector, angles_of
from imucalib.core.sphere import coverage, even_directions
from imucalib.effects import known
from imucalib.effects.scans import COLUMN
from imucalib.posterior.held_out import Predictions, predict_fitted, raw_errors
from imucalib.report import sections
from imucalib.report.conditions import (
    compose_sessions_section,
    compose_temperature_section,
    power_up_worths,
)
from imucalib.report.plots import band, sphere_map
from imucalib.report.render.document import (
    Card,
    Document,
    Facts,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Use,
    Worth,
)
from imucalib.significant_digits import number, plus_minus
from imucalib.units import DEG, MG

#: deg off the vertical, where it has no meaning, from which a tool-face is promised.
_FROM_VERTICAL = 30.0
_NORMAL_95 = 1.96
#: Words in the name of an effect and the quantity that an error of it follows.
_FOLLOWED = {
    "inclination": "inclination",
    "tool_face": "tool-face",
    "temperature": "temperature",
    "thermal": "temperature",
    "drift": "row",
    "step": "row",
    "warm": "row",
}


def compose_lab_document(run: LabRun) -> Document:
    """Everything that a reader of the calibration must know, the verdict first."""
    result, kind = run.result, run.request.population
    picture, *others = _residual_plots(run)
    rest = (
        _compose_angle_section(run),
        _compose_parameter_section(run),
        sections.compose_kind_section(kind, result.final, result.kind_chance, "position"),
        _compose_bench_section(run),
        compose_sessions_section(run.details.between_sessions),
        compose_temperature_section(run.calibration),
        _compose_dial_section(run),
        sections.compose_sensor_section(run.calibration),
        _compose_uncertainty_section(run),
        Section("Positions", (_position_table(run),)),
    )
    title = f"Lab calibration of {run.outcome.provenance.input}"
    plots = (*others, _attitude_map(run))
    card = _compose_card(run, picture)
    return sections.compose_calibration_document(title, run, card, residuals=plots, rest=rest)


def _knows_angles(run: LabRun) -> bool:
    """Whether inclination and tool-face of every position are known."""
    return isinstance(run.result.observations.reference, KnownVector)


def _errors_of(run: LabRun, held: Predictions) -> AttitudeErrors:
    """In the bench's own angles."""
    return attitude_errors(held, run.request.conventions)


def _compose_card(run: LabRun, picture: Plot) -> Card:
    """Errors on positions held out, angles at the worst attitude."""
    metric = "vector" if _knows_angles(run) else run.outcome.error.metric.partition(",")[0]
    like = ("attitudes", coverage(run.result.final.observations.reading[:, 0]))
    left_out = "positions" if run.details.between_sessions is None else "power-ups"
    good = [sections.error_worth(run.outcome.error, metric, left_out, like)]
    if run.result.observations.reference.directed:
        good.append(_worst(run))
    good += power_up_worths(run.details.between_sessions)
    if _knows_angles(run):
        good += _angles(run)
    if run.request.gravity_assumed:
        good.append(sections.gravity_worth(run.request.gravity))
    uses: tuple[Use, ...] = (sections.CORRECT,)
    if not run.recorded:
        purpose = "Take the coefficients to the instrument"
        uses = sections.propose_export(run.calibration, purpose, "c-header", "calibration.h")
    return sections.compose_card(run.outcome, good, uses=uses, picture=picture)


def _worst(run: LabRun) -> Worth:
    """The corrected vector where the calibration knows it least."""
    fit, directions = run.result.final, even_directions()
    slope, _ = force_slope(fit, run.request.gravity * directions)
    variance = np.einsum("nip,pq,niq->n", slope, fit.covariance, slope)
    sd = np.sqrt(np.maximum(variance, 0.0)) / MG
    return sections.worst_attitude("vector", sd, directions, "calibration only, ")


def _angles(run: LabRun) -> list[Worth]:
    """Of one corrected reading, 95 %, at the worst attitude; and on positions held out."""
    result, fit = run.result, run.result.final
    i, t = (g.ravel() for g in np.meshgrid(np.arange(-85.0, 86.0, 5.0), np.arange(0, 360, 15.0)))
    sigma = reading_noise(fit).whole
    found = angle_uncertainty(fit, i * DEG, t * DEG, run.request.gravity, sigma)
    held = _errors_of(run, result.splits[-1].final) if result.splits else None
    shown = run.request.conventions.outside(i * DEG, t * DEG)
    inclination = np.hypot(found.inclination_95, _NORMAL_95 * found.inclination_reading)
    tool_face = np.hypot(found.tool_face_95, _NORMAL_95 * found.tool_face_reading)
    tool_face[np.abs(i) > 90.0 - _FROM_VERTICAL] = 0.0
    where = f" {_FROM_VERTICAL:.0f} deg or more off the vertical"
    worths = []
    for name, half, off, most, promised in (
        ("inclination", inclination, held.inclination if held else None, 90.0, ""),
        ("tool-face", tool_face, held.tool_face if held else None, 180.0, where),
    ):
        k = int(np.argmax(half))
        at = f"worst{promised} (inclination {shown[0][k]:.0f}, tool-face {shown[1][k]:.0f} deg)"
        if off is not None:
            at += "; positions left out, with how they were set: "
            at += f"{rms(off):.2f} rms, {worst(off):.2f} largest"
        width = _within_a_circle(half[k], most, 2)
        value = f"± {width} deg" if half[k] < most else width
        worths.append(Worth(name, value, "95 %, one reading, worst attitude", at))
    return worths


def _within_a_circle(half: float, most: float, places: int) -> str:
    """Half the width of an angle's interval, deg. most : deg that the angle can be off by at all,
    so that a wider interval says nothing of it."""
    return f"{half:.{places}f}" if half < most else "not determined"


def _compose_parameter_section(run: LabRun) -> Section:
    factor = run.result.final.noise.factor
    note = "sd with the noise as estimated"
    if reading_noise(run.result.final).own > 0.0:
        note += f" ({factor:.2f} times the declared or assumed one); with the declared noise taken "
        note += f"at its word, divide by {factor:.2f}"
    return Section("Parameters", (sections.parameter_table(run.calibration, f"{note}."),))


def _compose_angle_section(run: LabRun) -> Section:
    result, directed = run.result, _knows_angles(run)

    def row(name: str, errors: AttitudeErrors) -> tuple[str, ...]:
        """Largest / rms of what the reference lets one compare."""
        values = [errors.tool_face, errors.inclination] if directed else []
        return (name, *(f"{worst(v):.2f} / {rms(v):.2f}" for v in (*values, errors.norm)))

    compared = [
        ("fitted, base", predict_fitted(result.base)),
        ("fitted, final", predict_fitted(result.final)),
    ]
    for split in result.splits:
        compared += [(f"{split.name}, base", split.base), (f"{split.name}, final", split.final)]
    rows = [row(name, _errors_of(run, held)) for name, held in compared]
    if result.loop and result.loop.records:
        aside = _errors_of(run, predict_fitted(result.loop.final))
        bad = [r.row for r in result.loop.records]
        rest = aside.take(np.setdiff1d(np.arange(len(aside.norm)), bad))
        rows.append(row("the same without the suspect records, on the others", rest))
    header = ("", *["tool-face, deg", "inclination, deg"] * directed, "|a|, mg")
    note = "Largest / rms."
    if bends(result.final):
        note += " Inclination is compared after undoing the fixture error that was found."
    used, n = len(result.used), result.observations.n
    if used != n:
        note += f" Model chosen and fitted on {used} rows; the other {n - used} are the test set."
    table = Table("Errors on the positions", header, tuple(rows), "", note)
    return Section("Angles and |a|" if directed else "|a|", (table,))


def _compose_bench_section(run: LabRun) -> Section:
    fit, reading = run.result.final, reading_noise(run.result.final)
    own = plus_minus(reading.own / MG, reading.own_sd / MG, "mg")
    rows = [("noise of a reading", own if reading.own > 0.0 else "0 (all of it shared)")]
    for k, (name, sd) in enumerate(setting_noise(fit).items(), start=1):
        spread_sd = sd / DEG * float(fit.noise_sd[k])
        rows.append((name, f"{plus_minus(sd / DEG, spread_sd, 'deg')} scatter"))
    if reading.shared > 0.0:
        size = plus_minus(reading.shared / MG, reading.shared_sd / MG, "mg")
        after = f"forgotten in {reading.memory:.2g} positions"
        rows.append(("noise that neighbours share", f"{size}, {after}"))
    rows.append(("local gravity", f"{run.request.gravity:.5f} m/s² ({run.request.gravity_source})"))
    order = (
        "by their time" if "time" in fit.observations.context else "of the file, taken as recorded"
    )
    reference = fit.observations.reference
    if isinstance(reference, KnownVector):
        set_ = (reference.inclination_setting.max() + 1, reference.tool_face_setting.max() + 1)
        order += f": inclination set {set_[0]} times, tool-face {set_[1]} times"
    rows += [("raw unit", run.raw.sentence), ("order of rows", order)]
    rows.append(("condition number", f"{fit.condition:.0f}, parameters in typical sizes"))
    rows += [("left open", words) for words in fit.null_directions]
    rows += [("left out", text) for text in run.details.left_out]
    words = dial_words(run.result)
    return Section("The bench", (Facts(tuple(rows)), *([Text(words)] if words else ())))


def _compose_dial_section(run: LabRun) -> Section:
    """What the bench's inclination dial is off by; empty when no such error was found."""
    title = "The bench's inclination dial"
    if not bends(run.result.final):
        return Section(title, ())
    at = np.linspace(0.0, 90.0, 61)
    dial = dial_of(run.result, at)
    interval = Series.from_half("95 % band", at, dial.shift, dial.half, "band")
    line = Series("true inclination minus dial", at, dial.shift, "line")
    caption = "What the bench's inclination dial is off by; no part of the sensor's calibration."
    labels = ("True inclination minus dial", "inclination (deg)", "dial's error (deg)")
    return Section(title, (Plot(*labels, (interval, line), caption),))


def _compose_uncertainty_section(run: LabRun) -> Section:
    """The parameters' uncertainty carried to the angles; empty without known angles."""
    fit = run.result.final
    if not _knows_angles(run):
        return Section("Uncertainty of the angles", ())
    at = np.radians(np.linspace(-85.0, 85.0, 69))
    sigma = reading_noise(fit).whole
    curves = [
        angle_uncertainty(fit, at, np.full(69, t), run.request.gravity, sigma)
        for t in np.radians([0, 90, 180, 270])
    ]
    inclination = np.max([c.inclination_95 for c in curves], axis=0)
    tool_face = np.max([c.tool_face_95 for c in curves], axis=0)
    x = run.request.conventions.outside(at, np.zeros_like(at))[0]
    labels = ("inclination (deg)", "half width (deg)")
    caption = "Half width of 95 % intervals, worst of four tool-faces; one reading's noise comes "
    caption += "on top."
    plots = (
        Plot(f"{what}, calibration only", *labels, (Series("95 %", x, half, "line"),), caption)
        for what, half in (("Inclination", inclination), ("Tool-face", tool_face))
    )
    rows = tuple(
        (
            f"{x[k]:.0f}",
            _within_a_circle(inclination[k], 90.0, 3),
            f"{curves[0].inclination_reading[k]:.3f}",
            _within_a_circle(tool_face[k], 180.0, 3),
            f"{curves[0].tool_face_reading[k]:.3f}",
        )
        for k in (int(np.argmin(np.abs(at / DEG - v))) for v in (0.0, 30.0, 50.0, 80.0))
    )
    header = ("inclination", "inc., 95 %", "inc., 1 reading", "tool-face, 95 %", "tf, 1 reading")
    note = "The frame's part (mounting, dial zero) is included; |a| cannot see it."
    table = Table("Uncertainty carried to the angles (deg)", header, rows, "rrrrr", note)
    return Section("Uncertainty of the angles", (table, *plots))


def _held_out_models(run: LabRun) -> tuple[Predictions, Predictions, bool]:
    """Base and final model of the used rows, held out where each of them was; whether they were."""
    result = run.result
    every = [s for s in result.splits if len(s.rows) == len(result.used)]
    if every:
        return every[-1].base, every[-1].final, True
    return predict_fitted(result.base), predict_fitted(result.final), False


def _residual_plots(run: LabRun) -> list[Plot]:
    """As read, before and after in one picture; then before and after alone: of the quantity that
    gained most against all that what was found follows, of the others by row."""
    base, final, held = _held_out_models(run)
    shown = {"raw": raw_errors(run.result.base), "before": base, "after": final}
    errors = {name: _errors_of(run, one) for name, one in shown.items()}
    quantities = [("|a|", "mg", "norm")]
    if _knows_angles(run):
        quantities += [("inclination", "deg", "inclination"), ("tool-face", "deg", "tool_face")]

    two = ("after",) if np.array_equal(base.error, final.error) else ("before", "after")

    def left(quantity: tuple[str, str, str]) -> float:
        first, last = (rms(getattr(errors[name], quantity[2])) for name in ("raw", *two)[-2:])
        return last / max(first, 1e-12)

    quantities.sort(key=left)
    axes = _axes(run)
    wanted = [(quantities[0], name) for name in _drivers(run) if name in axes]
    wanted += [(q, "row") for q in quantities if (q, "row") not in wanted]
    how = "Each row predicted without it" if held else "The fitted rows"
    how += "; before and after the search." if "before" in two else "."
    labels, wrong, bands = run.result.final.observations.label, _suspects(run), _bands(run)

    def drawn(quantity: tuple[str, str, str], name: str, *whose: str) -> Plot:
        x, (what, unit, key) = axes[name], quantity
        sizes = {one: getattr(errors[one], key) for one in whose}
        points = [Series(one, x, off, "points", names=labels) for one, off in sizes.items()]
        series = [band("noise and setting, ± 2 sd", x, bands[what]), *points]
        if wrong.size:
            series.append(Series("wrong record", x[wrong], sizes[whose[0]][wrong], "rings"))
        other = " (g)" if len(name) == 1 else "" if name.startswith(COLUMN) else " (deg)"
        x_label = name + {"row": "", "temperature": " (°C)"}.get(name, other)
        title, y_label = f"Error of {what} against {name}", f"error of {what} ({unit})"
        return Plot(title, x_label, y_label, tuple(series), how)

    return [drawn(*wanted[0], "raw", *two), *(drawn(*one, *two) for one in wanted)]


def _suspects(run: LabRun) -> Index:
    """Which of the used rows do not belong to the rest, by the search or by a slip of hand."""
    found = [r.row for r in run.result.loop.records] if run.result.loop else []
    slips = [row for fault in run.faults.slips for row in fault.rows]
    named = np.isin(row_numbers(run.result.final.observations), slips)
    return np.union1d(np.array(found, np.intp), np.flatnonzero(named))


def _axes(run: LabRun) -> dict[str, Array]:
    """What an error can follow, (n,) of each used row."""
    data = run.result.final.observations
    found = {"row": row_numbers(data).astype(np.float64)}
    reading = data.reading[:, 0] / gravity_of(run.result.observations)
    found |= {axis: reading[:, k] for k, axis in enumerate("xyz")}
    if isinstance(data.reference, KnownVector):
        angles = angles_of(predict_fitted(run.result.final).expected[:, 0])
        inclination, tool_face = run.request.conventions.outside(*angles)
        found |= {"inclination": inclination, "tool-face": tool_face}
    more = data.context.covariates
    shown = (name for name in more if name == "temperature" or name.startswith(COLUMN))
    return found | {name: more[name] for name in shown}


def _drivers(run: LabRun) -> tuple[str, ...]:
    """What the effects that were found follow, or what stays, first found first."""

    def of(effect: str) -> tuple[str, ...]:  # a column that it follows has its needs alone
        own = known(effect) if effect.startswith("follows@") else None
        return own.needs if own else tuple(d for word, d in _FOLLOWED.items() if word in effect)

    loop = run.result.loop
    effects = [s.effect for s in loop.steps] if loop else []
    named = [d for e in effects for d in of(e)]
    # A sensor's own curve acts on the axis: all three are shown.
    own = [a for e in effects if not of(e) for a in "xyz"]
    stays = [u.driver for u in loop.unexplained] if loop else []
    return tuple(dict.fromkeys((*named, *own, *stays)))


def _bands(run: LabRun) -> dict[str, float]:
    """Two standard deviations of a reading's noise and of a setting, mg and deg."""
    fit = run.result.final
    sigma = reading_noise(fit).whole
    bands = {"|a|": 2.0 * sigma / MG}
    if isinstance(fit.observations.reference, KnownVector):
        angles = angles_of(predict_fitted(fit).expected[:, 0])
        found = angle_uncertainty(fit, *angles, run.request.gravity, sigma)
        settings = setting_noise(fit)
        own = {"inclination": found.inclination_reading, "tool-face": found.tool_face_reading}
        for name, sd in own.items():
            set_sd = next((v for n, v in settings.items() if n.startswith(name)), 0.0) / DEG
            bands[name] = 2.0 * float(np.hypot(np.median(sd), set_sd))
    return bands


def _attitude_map(run: LabRun) -> Plot:
    """Attitudes that were seen and the error at each."""
    _, final, held = _held_out_models(run)
    error = np.linalg.norm(final.error[:, 0], axis=-1) / MG
    how = "Each row predicted without it." if held else "The fitted rows."
    caption = (
        f"Equal areas of the map are equal parts of the sphere. {how} Local gravity "
        f"{gravity_of(run.result.observations):.4f} m/s²."
    )
    names = run.result.final.observations.label
    return sphere_map(final.expected[:, 0], error, caption, names=names)


def _position_table(run: LabRun) -> Table:
    """Residual of every fitted position: raw axes, angles, |a|; and as predicted without it."""
    fit, directed = run.result.final, _knows_angles(run)
    residual = fit.residual()[:, 0] / MG
    own = _errors_of(run, predict_fitted(fit))
    split = run.result.splits[0] if run.result.splits else None
    alone = _errors_of(run, split.final) if split and split.name == "leave one out" else own

    def cells(k: int, errors: AttitudeErrors) -> list[str]:
        angles = [errors.tool_face[k], errors.inclination[k]] if directed else []
        return [number(v) for v in (*angles, errors.norm[k])]

    rows = tuple(
        (label, *(f"{v:.2f}" for v in residual[k]), *cells(k, own), *cells(k, alone))
        for k, label in enumerate(fit.observations.label)
    )
    header = ["position", "x, mg", "y, mg", "z, mg"]
    header += [*["tf, deg", "inc, deg"] * directed, "|a|, mg"]
    header += [*["tf, left out", "inc, left out"] * directed, "|a|, left out"]
    note = (
        "x, y, z: reading minus prediction at the estimated settings. "
        "Left out: predicted without the row."
    )
    return Table("Residuals by position", tuple(header), rows, "", note)
