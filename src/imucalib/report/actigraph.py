"""The report of `imucal actigraph`, as data, and that of the paper's own procedure."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucalib.calibrators.actigraph.errors import Coverage, norm_sd
from imucalib.calibrators.actigraph.observations import from_data, hours
from imucalib.calibrators.actigraph.published import PublishedRun
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.calibrators.actigraph.series import CalibrationSeries as Calibrations
from imucalib.core.sphere import coverage, even_directions
from imucalib.exports.nearest import nearest_row
from imucalib.posterior.held_out import raw_errors
from imucalib.report import sections
from imucalib.report.plots import band, sphere_map
from imucalib.report.render.document import (
    Card,
    Column,
    Document,
    Facts,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Worth,
)
from imucalib.significant_digits import per_cent, plus_minus, probability, two_digits
from imucalib.units import MG

_BINS = 60
#: Two standard deviations of noise whose mean size is one.
_NOISE = 2.0 * float(np.sqrt(np.pi / 2.0))


_SPHERE: tuple[Column, ...] = (
    ("towards", "name", ""),
    ("runs", "runs", "d"),
    ("raw", "raw_mg", ".2f"),
    ("nine", "base_mg", ".2f"),
    ("final", "final_mg", ".2f"),
    ("held out", "held_out_mg", ".2f"),
    ("sd", "sd_mg", ".2f"),
)
_BEFORE_AFTER: tuple[Column, ...] = (
    ("mg", lambda one: one[0], ""),
    ("raw", lambda one: one[1].raw, ".2f"),
    ("corrected", lambda one: one[1].corrected, ".2f"),
    ("change", lambda one: one[1].corrected - one[1].raw, "+.2f"),
)


_METHODS: tuple[Column, ...] = (
    ("method", lambda one: one[0], ""),
    ("fitted, mg", lambda one: one[1].fitted_mg, ".2f"),
    ("second set, mg", lambda one: one[1].verified_mg, ".2f"),
    ("R, %", lambda one: one[1].improvement_percent, ".0f"),
)


def compose_actigraph_document(run: ActigraphRun) -> Document:
    """Everything that a reader of the calibration must know, the verdict first."""
    picture, *others = _residual_plots(run)
    first = (_of_a_kind(run), _activity(run))
    rest = (
        _compose_series_section(run.series),
        _parameters(run),
        _coverage(run),
        Section("Error over the sphere", _sphere_blocks(run)),
        _rule(run),
        sections.compose_sensor_section(run.calibration),
    )
    title, card = (
        f"Calibration of {Path(run.scanned.path).name} by gravity",
        _compose_card(run, picture),
    )
    return sections.compose_calibration_document(
        title, run, card, first=first, residuals=others, rest=rest
    )


def _compose_card(run: ActigraphRun, picture: Plot) -> Card:
    """|a| at rest, and in the worst direction."""
    directions = even_directions()
    sd = norm_sd(run.result.final, directions) / MG
    like = ("postures", coverage(run.result.runs.mean))
    good = [
        sections.error_worth(run.outcome.error, "|a| at rest", "time", like),
        sections.worst_attitude("|a|", sd, directions),
    ]
    enmo = run.details.activity.enmo_mg if run.details.activity else {}
    if "night" in enmo and "day" in enmo:  # where one can be told from the other
        night, day = enmo["night"], enmo["day"]
        detail = f"raw reading {night.raw:.2g}; by day {day.raw:.2g} raw, {day.corrected:.2g} "
        worth = Worth("ENMO at night", f"{two_digits(night.corrected)} mg", f"{detail}corrected")
        good.append(worth)
    ggir = sections.propose_export(run.calibration, "For GGIR", "ggir-csv", "ggir.csv")
    uses = (sections.CORRECT, *ggir)
    return sections.compose_card(run.outcome, good, uses=uses, picture=picture)


def _of_a_kind(run: ActigraphRun) -> Section:
    """What a fleet said, and what that does to the uncertainty."""
    said, fit, title = run.result.of_a_kind, run.result.final, "Fleet prior"
    if said is None:
        return Section(title, ())
    if np.isnan(said.chance):
        words = "Its own postures tell all nine parameters so well that the fleet was not needed."
        return Section(title, (Text(words),))
    if not said.used:
        words = (
            "Prior not used: device differs from its fleet, p = "
            f"{probability(said.chance, 999)}. The calibration is the recording's own."
        )
        return Section(title, (Text(words, "warning"),))
    kind = sections.compose_kind_section(said.kind, fit, said.chance, "posture run", said.alone)
    before, now = (
        1.96 * float(norm_sd(one, even_directions()).max()) / MG for one in (said.alone, fit)
    )
    words = (
        f"|a| is known to ± {now:.2g} mg (95 %) in the worst attitude, without the fleet to "
        f"± {before:.2g} mg."
    )
    return Section(title, (*kind.blocks, Text(words)))


def _activity(run: ActigraphRun) -> Section:
    """Wear, ENMO and |a| at night, before and after; empty where the samples were not seen."""
    found = run.details.activity
    if found is None:
        return Section("Wear and activity", ())
    night, off = "cannot be named: too little of a day was seen", found.not_worn_s
    if found.night_s_of_day is not None:
        each = found.night_s_of_day
        start, stop = (f"{int(s // 3600):02d}:{int(s % 3600 // 60):02d}" for s in each)
        night = f"{start} to {stop}, the least active five hours"
    spans = ", ".join(f"{a / 3600:.2f} to {b / 3600:.2f} h" for a, b in off[:4])
    spans += f" and {len(off) - 4} more" if len(off) > 4 else ""
    facts = (
        ("worn", f"{found.hours_worn:.1f} of {found.hours_recorded:.1f} h"),
        ("not worn", f"{spans}, from the start" if spans else "never an hour in a row"),
        ("night", night),
    )
    compared = [(f"ENMO, {name}", both) for name, both in found.enmo_mg.items()]
    if found.night_posture_runs:
        name = f"error of |a| at rest, night ({found.night_posture_runs} runs)"
        compared.append((name, found.night_error_mg))
    note = (
        "ENMO: mean of max(|a| - 1 g, 0) over the samples of worn time. The error at rest is held "
        "out: each run predicted without its block of time."
    )
    table = Table.from_columns(_BEFORE_AFTER, compared, "Before and after", note)
    profile = found.enmo_by_hour_mg
    hour = np.repeat(np.arange(25.0), 2)[1:-1]
    means = zip(("raw", "corrected"), profile.T, strict=True)
    steps = (Series(name, hour, np.repeat(mean, 2), "line") for name, mean in means)
    labels = ("ENMO over the day", "hour of the day (h)", "ENMO (mg)")
    plot = Plot(*labels, tuple(steps), "Mean of each hour of the recording's clock, worn time.")
    return Section("Wear and activity", (Facts(facts), table, plot))


def _rule(run: ActigraphRun) -> Section:
    """Our coefficients in GGIR's form and those of its own rule; empty without windows."""
    rule, title = run.details.ggir_rule, "Beside GGIR's rule"
    if rule is None:
        return Section(title, ())
    row = nearest_row(run.calibration)
    compared = (("scale", row.scale, rule.scale), ("offset", row.offset, rule.offset_g))
    rows = tuple(
        (f"{name} {axis}", f"{a:.5f}", f"{b:.5f}", f"{a - b:+.5f}")
        for name, ours, theirs in compared
        for axis, a, b in zip("xyz", ours, theirs, strict=True)
    )
    note = (
        "corrected = scale (raw + offset), g. Ours: the row that `--export ggir-csv` writes, "
        f"nearest to the whole calibration, which it misses by {row.lost:.2f} mg on average."
    )
    header = ("", "imucal", "GGIR's rule", "difference")
    fitted = np.mean(np.abs(rule.norm_error(run.runs.mean))) / MG
    words = [
        (
            "windows of its rule",
            f"{rule.windows}, {rule.error_before_mg:.2f} mg before, {rule.error_after_mg:.2f} mg "
            "after, on the windows that were fitted",
        ),
        (
            "on the posture runs",
            f"{fitted:.2f} mg with its coefficients, which have seen them; "
            f"{run.outcome.error.held_out.final:.2f} mg with ours on time held out",
        ),
    ]
    if not rule.enough:
        words.append(("its own condition", "not met: an axis has not seen both signs of 0.3 g"))
    table = Table("Six coefficients", header, rows, "lrrr", note)
    return Section(title, (table, Facts(tuple(words))))


def _compose_series_section(found: Calibrations | None) -> Section:
    """Each part's parameters, and whether they differ; empty where all is one part."""
    title = "Recalibration over time"
    if found is None:
        return Section(title, ())
    good = [part for part in found.parts if part.fit is not None]
    words = f"One calibration serves all {len(good)} parts ({per_cent(1.0 - found.probability)})"
    if found.differ:
        words = f"The {len(good)} calibrations differ ({per_cent(found.probability)})"
    words += f": {', '.join(one.effect for one in found.moved)}" if found.moved else ""
    rows = []
    for part in found.parts:
        cells = [part.reason, "-", "-"]
        if (fit := part.fit) is not None:
            cells = list(map(plus_minus, fit.theta[:3], fit.sd[:3]))
        rows.append((hours(part.start), str(part.runs), *cells))
    serves = "the part valid at its time" if found.differ else "the calibration of the whole"
    note = (
        f"`imucal apply` corrects each sample with {serves}. All parameters of the parts are in "
        "report.json."
    )
    table = Table("Bias by part (mg)", ("from", "runs", "x", "y", "z"), tuple(rows), "lrrrr", note)
    middle = np.array([0.5 * (p.start + p.stop) / 86400.0 for p in good])
    off = np.array([p.fit.theta[:3] - found.common[:3] for p in good if p.fit]).T
    half = 2.0 * np.array([p.fit.sd[:3] for p in good if p.fit]).T
    each = zip(found.parameters[:3], off, half, strict=True)
    curves = tuple(Series.from_half(p.name, middle, y, two_sd, "points") for p, y, two_sd in each)
    caption = "Change from what all parts have in common; whiskers: two standard deviations."
    plot = Plot("Bias over time", "time (d)", "change of bias (mg)", curves, caption)
    text = Text(f"{words}.", "warning" if found.differ else "ok")
    return Section(title, (text, table, plot))


def _parameters(run: ActigraphRun) -> Section:
    note = (
        "Uncertainty by posture run: windows of one posture are not independent. Data: the share "
        "of what is known that the recording has shown, 1 - (sd / typical size)²."
    )
    shares = from_data(run.result.final).tolist()
    return Section("Parameters", (sections.parameter_table(run.calibration, note, shares),))


def _coverage(run: ActigraphRun) -> Section:
    c = run.details.coverage
    ends = c.axis_range_g.items()
    seen = ", ".join(f"{a} {low:+.2f} to {high:+.2f} g" for a, (low, high) in ends)
    noise = ", ".join(f"{v:.2g}" for v in c.noise_of_a_sample_mg)
    still = f"{c.still_windows} of {c.windows} windows of {c.window_s:g} s"
    rows = [
        ("recorded", f"{c.hours:.1f} h at {c.rate_hz:g} Hz"),
        ("at rest", f"{still}, {c.posture_runs} posture runs"),
        ("seen of gravity", seen),
        ("noise", f"{noise} mg a sample{_steps(c)}"),
        ("local gravity", f"{run.request.gravity:.5f} m/s² ({run.request.gravity_source})"),
    ]
    if c.temperature_degC is not None:
        low, high = c.temperature_degC
        reference = f"reference {c.temperature_reference_degC:g} °C"
        rows.append(("temperature", f"{low:.1f} to {high:.1f} °C; {reference}"))
    if c.runs_that_count_less:
        rows.append(("count less", f"{c.runs_that_count_less} runs that nothing else is like"))
    return Section("What was recorded", (Facts(tuple(rows)),))


def _steps(coverage: Coverage) -> str:
    """The resolution, and whether the noise averages it out."""
    step, size = float(coverage.resolution_mg.max()), coverage.quantisation_mg
    if step < 0.05 * float(coverage.noise_of_a_sample_mg.min()):  # numbers as fine as their format
        return ""
    if size == 0.0:
        return f"; the smallest step, {step:.2g} mg, averages out"
    return f"; the smallest step, {step:.2g} mg, does not average out: {size:.2g} mg a posture"


def _residual_plots(run: ActigraphRun) -> list[Plot]:
    """Error of |a| of every posture run, raw, and before and after the search, held out."""
    result, runs = run.result, run.runs
    before = result.base_held.error[:, 0, 0] / MG if result.loop and result.added else None
    after = result.final_held.error[:, 0, 0] / MG
    raw = raw_errors(result.base).error[:, 0, 0] / MG
    unit, seconds = ("d", 86400.0) if runs.time[-1] > 3.0 * 86400.0 else ("h", 3600.0)
    when = runs.time / seconds
    axes = [("time", f"time ({unit})", when)]
    if np.isfinite(runs.temperature).all() and np.ptp(runs.temperature) > 0.0:
        axes.append(("temperature", "temperature (°C)", runs.temperature))
    means = zip("xyz", runs.mean.T / run.request.gravity, strict=True)
    axes += [(f"the reading of {a}", f"{a} (g)", mean) for a, mean in means]
    both = (Series("raw reading", when, raw, "points"), Series("corrected", when, after, "points"))
    caption = "One point a posture run; the figures below show the corrected ones alone."
    title, y_label = "Error of |a| raw and corrected", "error of |a| (mg)"
    plots = [Plot(title, f"time ({unit})", y_label, both, caption)]
    noise = _NOISE * result.error.floor
    caption = (
        "One point a posture run, predicted without its block of time; a line that leaves zero is "
        "what no effect explains."
    )
    for name, label, x in axes:
        # Means over stretches of equally many points.
        stretches = np.array_split(np.argsort(x), min(_BINS, max(1, x.size // 5)))
        centre, mean = (np.array([v[s].mean() for s in stretches]) for v in (x, after))
        series = [Series("after", x, after, "points"), Series("mean after", centre, mean, "line")]
        if before is not None:
            series.insert(0, Series("before", x, before, "points"))
        if np.isfinite(noise):
            series.insert(0, band("noise alone, ± 2 sd", x, noise))
        plots.append(Plot(f"Error of |a| against {name}", label, y_label, tuple(series), caption))
    return plots


def _sphere_blocks(run: ActigraphRun) -> tuple[Plot, Table]:
    """The error over the sphere as a map of the runs and as a table of its parts."""
    result, directions = run.result, even_directions(600)
    sd = norm_sd(result.final, directions) / MG
    bar = max(1.0, float(np.quantile(sd, 0.8)))
    caption = (
        "Equal areas of the map are equal parts of the sphere. One point a posture run, predicted "
        "without its block of time."
    )
    map_ = sphere_map(
        result.fitted.corrected[:, 0],
        result.final_held.error[:, 0, 0] / MG,
        caption,
        poor=directions[sd > bar],
        poor_words=f"|a| known to worse than {bar:.2g} mg (sd)",
    )
    title = "Mean error of |a| by direction (mg)"
    note = "sd: what the parameters' uncertainty leaves there, with or without postures."
    return map_, Table.from_columns(_SPHERE, run.details.sphere, title, note)


def compose_published_document(run: PublishedRun) -> Document:
    """The paper's own procedure: its methods next to each other, verified; parameters, points."""
    note = "Fixed point: operands of 32 or 16 bits, products of twice as many, no square root."
    title = "The paper's methods on the same 18 points (paper 002, Table 3)"
    methods = Table.from_columns(_METHODS, run.details.methods.items(), title, note)
    note = "sd from the residual of the points; 18 points leave 9 degrees of freedom."
    points = tuple(
        (f"{k}", *(f"{v:+.4f}" for v in p)) for k, p in enumerate(run.details.points_g, 1)
    )
    rest = (
        Section("Methods", (methods,)),
        Section("Parameters", (sections.parameter_table(run.calibration, note),)),
        Section("Points", (Table("Points (g)", ("", "x", "y", "z"), points, "lrrr"),)),
    )
    title = f"Calibration of {Path(run.scanned.path).name} as published"
    worth = sections.error_worth(run.outcome.error, "|a| at rest", "points")
    card = sections.compose_card(run.outcome, [worth], uses=(sections.CORRECT,))
    return sections.compose_calibration_document(title, run, card, rest=rest)
