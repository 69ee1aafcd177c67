"""How the positions' uncertainty falls as more of the motion is used."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.run import ArrayRun
from imucalib.errors import ImucalError
from imucalib.estimators.array.mode import laplace_frame
from imucalib.report.document import Plot, Series, Table

_SHARES = (0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
_FEWEST = 10  # samples below which a part is not shown


def growth_blocks(run: ArrayRun) -> tuple[Plot | Table, ...]:
    """Median standard deviation of each axis against the number of samples, drawn and as Table II
    of paper 001 has it; empty where the samples do not allow it."""
    data, final = run.final.data, run.final
    if final.sampler == "gaussian":
        return ()
    counts = [round(s * data.samples) for s in _SHARES]
    found = [(n, sd) for n in counts if n >= _FEWEST and (sd := _median_sd(run, n)) is not None]
    if len(found) < 3 or found[-1][0] != data.samples:
        return ()
    n = np.array([f[0] for f in found], np.float64)
    sd = 1e3 * np.array([f[1] for f in found])
    # The stated uncertainty holds more than the motion's: the curve ends at what is stated.
    sd *= 1e3 * np.median(final.sd[1:], axis=0) / sd[-1]
    series = [Series(axis, n, sd[:, k], "points") for k, axis in enumerate("xyz")]
    fine = np.geomspace(n[0], n[-1], 60)
    series.append(Series("1/√T", fine, sd[-1].mean() * np.sqrt(n[-1] / fine), "line"))
    caption = (
        "Median over the IMUs, from the Gaussian at the mode of evenly chosen parts of the "
        "samples, scaled to end at what is stated. Twice the precision takes four times the motion."
    )
    title = "Standard deviation against the samples used"
    rows = tuple((f"{t:.0f}", *(f"{v:.2g}" for v in row)) for t, row in zip(n, sd, strict=True))
    table = Table(title, ("T", "sd x", "sd y", "sd z"), rows, "rrrr", "mm, as drawn above.")
    return Plot(title, "samples used", "sd (mm)", tuple(series), caption, log_y=True), table


def _median_sd(run: ArrayRun, count: int) -> Array | None:
    """(3,) m; None where so few samples have no mode."""
    data, prior = run.final.data, run.final.prior
    rows = np.linspace(0, data.samples - 1, count).astype(np.intp)
    frame = run.final.frame if count == data.samples else None
    try:
        frame = frame or laplace_frame(data.take(rows), prior)
    except ImucalError:
        return None
    variance = np.diag(frame.covariance)[: prior.positions].reshape(-1, 3)
    return np.asarray(np.sqrt(np.median(variance, axis=0)))
