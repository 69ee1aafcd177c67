"""Tables of the lab report that are long: positions, ISCWSA codes, the paper's own layout."""

from __future__ import annotations

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.lab.attitude import attitude_errors
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector, angles_of
from imucalib.loop.held_out import errors as held_errors
from imucalib.loop.held_out import fitted
from imucalib.report.document import Block, Table, Text
from imucalib.units import MG


def position_table(run: LabRun) -> Table:
    """Residual of every fitted position: raw axes, angles, |a|; leave-one-out beside it."""
    fit = run.result.final
    residual = fit.residual()[:, 0] / MG
    meant = run.request.settings.conventions
    angle = attitude_errors(fitted(fit), meant)
    split = run.result.splits[0] if run.result.splits else None
    left = attitude_errors(split.final, meant) if split and split.name == "leave one out" else angle

    def number(value: float, places: int) -> str:
        return "-" if not np.isfinite(value) else f"{value:.{places}f}"

    known = isinstance(fit.observations.reference, KnownVector)
    rows = []
    for k, label in enumerate(fit.observations.label):
        cells = [label, *(number(float(v), 2) for v in residual[k])]
        if known:
            cells += [number(float(angle.tool_face[k]), 2), number(float(angle.inclination[k]), 2)]
        cells += [number(float(angle.norm[k]), 2)]
        if known:
            cells += [number(float(left.tool_face[k]), 2), number(float(left.inclination[k]), 2)]
        cells += [number(float(left.norm[k]), 2)]
        rows.append(tuple(cells))
    header: tuple[str, ...] = ("position", "x, mg", "y, mg", "z, mg")
    if known:
        header += ("tf, deg", "inc, deg", "|a|, mg")
        header += ("tf, left out", "inc, left out", "|a|, left out")
    else:
        header += ("|a|, mg", "|a|, left out")
    note = (
        "x, y, z: reading minus prediction at the estimated settings. "
        "Left out: predicted without the row."
    )
    return Table("Residuals by position", header, tuple(rows), "l" + "r" * (len(header) - 1), note)


def iscwsa_table(calibration: Calibration) -> Table:
    """ISCWSA error-model codes: the error that was removed and the 1-sigma that stays."""
    linear = calibration.matrices()
    by_name = {p.name: p for p in calibration.parameters}
    pair = (0, 1)

    def rss(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    scale = np.abs(linear.scale - 1.0)
    b, b_sd = np.abs(linear.bias_mg) * MG, linear.bias_mg_sd * MG
    rows = [
        ("ABXY", "m/s²", rss([b[k] for k in pair]), rss([b_sd[k] for k in pair]), 0.004),
        ("ABZ", "m/s²", float(b[2]), float(b_sd[2]), 0.004),
        ("ASXY", "-", rss([scale[k] for k in pair]), rss([linear.scale_sd[k] for k in pair]), 5e-4),
        ("ASZ", "-", float(scale[2]), float(linear.scale_sd[2]), 5e-4),
    ]
    tilt = [by_name[f"mounting_{a}"] for a in "xy" if f"mounting_{a}" in by_name]
    if tilt:
        rows.append(("XYM", "deg", rss([p.value for p in tilt]), rss([p.sd for p in tilt]), 0.1))
    text = tuple(
        (code, unit, f"{value:.5f}", f"{sd:.5f}", f"{model:g}")
        for code, unit, value, sd, model in rows
    )
    return Table(
        "ISCWSA-coded equivalents",
        ("code", "unit", "removed", "left (1 sd)", "MWD model"),
        text,
        "llrrr",
        "XY is the rms of both axes. MWD model: the standard's 1-sigma, for comparison.",
    )


def published_table(run: LabRun) -> Table:
    """All positions in the layout of paper 004's Table 2: components, angles and their errors."""
    fit, whole = run.result.final, run.result.observations
    corrected = fit.model.correct(fit.theta, whole.reading, whole.context)[:, 0]
    meant = run.request.settings.conventions
    inclination, tool_face = meant.outside(*angles_of(corrected))
    errors = attitude_errors(held_errors(fit, fit.theta, whole), meant)
    rows = []
    for k, label in enumerate(whole.label):
        shown = float(np.mod(tool_face[k] + 1.0, 360.0) - 1.0)
        near = np.isfinite(errors.tool_face[k])
        rows.append(
            (label, *(f"{v:.5f}" for v in corrected[k]), f"{shown:.3f}" if near else "-",
             f"{abs(errors.tool_face[k]):.3f}" if near else "-", f"{inclination[k]:.3f}",
             f"{abs(errors.inclination[k]):.3f}")
        )  # fmt: skip
    header = ("position", "a_x", "a_y", "a_z", "tf", "error", "incl", "error")
    return Table("Corrected components (m/s²) and angles (deg)", header, tuple(rows), "lrrrrrrr")


def training_note(run: LabRun) -> list[Block]:
    """Which rows chose and fitted, when a test set was kept apart."""
    used, n = len(run.result.used), run.result.observations.n
    if used == n:
        return []
    return [Text(f"Model chosen and fitted on {used} rows; the other {n - used} are the test set.")]
