"""Figures 2, 3 and 4 of paper 001 from our own sampler: python benchmarks/array/figures.py FOLDER.

Data are simulated as in its section IV-A: 32 IMUs, 0.04 m/s² and 0.06 deg/s, ω, dω/dt and s normal
with 1000 deg/s, 35 000 deg/s² and 20 m/s²; prior of 3 mm about positions that are 0.1 mm off.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from samples import MotionPlan, simulated_samples

from imucalib.calibrators.array.board import read_board
from imucalib.estimators.array.problem import ArrayData, ArrayPrior
from imucalib.estimators.array.sampler import ArrayPositions, sample_positions
from imucalib.estimators.markov.convergence import autocorrelation
from imucalib.estimators.markov.hmc import Stop
from imucalib.estimators.markov.pmmh import MonteCarloLikelihood
from imucalib.report.document import Plot, Series
from imucalib.report.render.svg import render_svg

Array = NDArray[np.float64]
LENGTHS = (5, 50, 500)
COUNTS = (1, 2, 5, 10, 20, 50, 100)
REALISATIONS = 1000
WIDTH, HEIGHT = 430, 320


def problem(samples: int) -> tuple[ArrayData, ArrayPrior, Array]:
    """Data, prior and the true positions."""
    true = read_board("mimu4444").drawn
    rng = np.random.default_rng(samples)
    off = rng.normal(size=true.shape) * 1e-4
    off[0] = 0.0
    data = simulated_samples(true, MotionPlan(samples=samples), rng)
    return data, ArrayPrior(true + off), true


def variance_plot() -> Plot:
    """Figure 2: variance of log p̂_N at the prior mean over N."""
    series, lines = [], []
    n = np.log10(COUNTS)
    for samples in LENGTHS:
        data, prior, _ = problem(samples)
        flat = ArrayPrior(prior.nominal, motion="flat")
        rng = np.random.default_rng(1)
        variance = []
        for count in COUNTS:
            estimator = MonteCarloLikelihood(data, flat, count)
            rows = max(1, 100_000 // (samples * count))
            x = np.repeat(flat.mean_vector[None], rows, axis=0)
            values = [estimator.log(x, rng) for _ in range(-(-REALISATIONS // rows))]
            variance.append(np.concatenate(values)[:REALISATIONS].var(ddof=1))
        v = np.array(variance)
        level = np.exp(np.mean(np.log(v * np.array(COUNTS))))
        series.append(Series(f"T = {samples}", n, v, "points"))
        lines += [*level / np.array(COUNTS), np.nan]
    x = np.tile([*n, np.nan], len(LENGTHS))
    series.append(Series("~ 1/N", x, np.array(lines), "line"))
    return Plot("Variance of log p̂_N", "log10 N", "variance", tuple(series), log_y=True)


def chain_plots(found: ArrayPositions) -> list[Plot]:
    """Figure 3: trace, histogram and autocorrelation of two chains, r2 x at T = 500."""
    draws = 1e6 * found.unknowns[:2, :, 0]
    n = np.arange(draws.shape[1], dtype=np.float64)
    edges = np.linspace(draws.min(), draws.max(), 25)
    middle = 0.5 * (edges[1:] + edges[:-1])
    rho = autocorrelation(draws.T)[:31]

    def both(x: Array, values: Sequence[Array], mark: str) -> tuple[Series, ...]:
        return tuple(Series(f"chain {k + 1}", x, v, mark) for k, v in enumerate(values))

    counts = [np.histogram(d, edges)[0].astype(np.float64) for d in draws]
    return [
        Plot("Trace", "draw", "x of r2 (µm)", both(n, list(draws), "line")),
        Plot("Histogram", "x of r2 (µm)", "draws", both(middle, counts, "step")),
        Plot("Autocorrelation", "lag (draws)", "", both(n[:31], list(rho.T), "line")),
    ]


def posterior_plots(found: dict[int, ArrayPositions], true: Array) -> list[Plot]:
    """Figure 4: prior and posteriors of IMU 2's position less the truth, densities."""
    at = np.linspace(-0.1, 0.1, 401)
    plots = []
    for axis in range(3):
        first = next(iter(found.values())).prior
        off = 1e3 * (first.mean_vector[axis] - true[1, axis])
        sd = 1e3 * first.sd
        prior = np.exp(-0.5 * ((at - off) / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
        series = [Series("prior", at, prior, "line")]
        for samples, positions in found.items():
            draws = 1e3 * (positions.unknowns[..., axis].ravel() - true[1, axis])
            width = 1.06 * draws.std() * len(draws) ** -0.2
            kernel = np.exp(-0.5 * ((at[:, None] - draws) / width) ** 2)
            density = kernel.mean(axis=1) / (width * np.sqrt(2.0 * np.pi))
            shown = np.where(density > 0.1, density, np.nan)
            series.append(Series(f"T = {samples}", at, shown, "line"))
        title = f"{'xyz'[axis]} of r2 less the truth (mm)"
        plots.append(Plot(title, title, "density (1/mm)", tuple(series), log_y=True))
    return plots


def side_by_side(plots: Sequence[Plot]) -> str:
    """One SVG of several plots in a row, on white."""
    parts = [f'<svg x="{WIDTH * k}"{render_svg(p, WIDTH, HEIGHT)[4:]}' for k, p in enumerate(plots)]
    size = f'width="{WIDTH * len(plots)}" height="{HEIGHT}"'
    return (f'<svg xmlns="http://www.w3.org/2000/svg" {size}><rect {size} fill="white"/>'
            f"{''.join(parts)}</svg>\n")  # fmt: skip


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    found, truth = {}, np.empty(0)
    for samples in LENGTHS:
        data, prior, truth = problem(samples)
        rng = np.random.default_rng(2)
        found[samples] = sample_positions(data, prior, rng, chains=4, stop=Stop(ess=1500))
    figures = {
        "array_figure_2": [variance_plot()],
        "array_figure_3": chain_plots(found[500]),
        "array_figure_4": posterior_plots(found, truth),
    }
    for name, plots in figures.items():
        path = folder / f"{name}.svg"
        path.write_text(side_by_side(plots), encoding="utf-8")
        print(path, path.stat().st_size)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]))
