"""The linear bench on a grid of noise: what any change of its readings does to the likelihood.

y = (I ⊗ [a, 1]) b + e,  e ~ N(0, s² V),  V = I + r_i² N_i N_i' + r_t² N_t N_t' + k² E E'

N: what one degree of each setting does; E: what bench and sensor may do beside (dial zero, scale,
eccentricities, squares) at physical size, integrated out. s is profiled, b integrated out (REML):
with P = V⁻¹ - V⁻¹X(X'V⁻¹X)⁻¹X'V⁻¹ and ν = 3n - 12, log L = c - ν/2 ln y'Py + prior, and for other
readings only y'Py changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.loop.faults.sheet import Sheet, slopes

#: Scatter of a setting (deg), size of what else may be (deg), noise (mg): scales of Cauchy-like
#: priors. Ten degrees of scatter cost 7 nats, so a scatter cannot swallow a wrong row.
SCATTER, BESIDE, NOISE = 0.3, 1.0, 10.0
#: Settings in deg a mg of noise, and the share of E, deg a mg of noise.
_SETTING = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
_SHARE = (0.0, 0.5, 5.0)
_COARSE = (0.03, 0.3)
_FEW = (0.03, 0.3, 3.0)
#: Rows up to which the whole grid is affordable (0.15 CPU s at 32 rows).
_FULL_GRID = 48
#: Squares of the response, mg/g² for one degree of everything else.
_SQUARES = 2.0


@dataclass(frozen=True)
class Grid:
    """Points of noise: r_i, r_t and k (G,), deg a mg of noise."""

    inclination: Array
    tool_face: Array
    share: Array

    def prior(self, noise: Array) -> Array:
        """Log prior at a noise (G, ...) in mg of every point."""
        shape = (-1,) + (1,) * (noise.ndim - 1)
        found = -np.log1p((noise / NOISE) ** 2)
        for size, typical in (
            (self.inclination, SCATTER),
            (self.tool_face, SCATTER),
            (self.share, BESIDE),
        ):
            found = found - np.log1p((size.reshape(shape) * noise / typical) ** 2)
        return np.asarray(found)


@dataclass(frozen=True)
class Terms:
    """What the readings are linear in: design (3n, 12), beside (3n, q), a degree of each setting
    (3n, settings), and the turn (3, 3) of the sensor in the tool."""

    design: Array
    beside: Array
    inclination: Array
    tool_face: Array
    turn: Array


@dataclass(frozen=True)
class Base:
    """The sheet as it stands, at every point of the grid.

    P : (G, 3n, 3n); g : P y (G, 3n); rss : y'Py (G,); c : (G,) log determinants
    """

    sheet: Sheet
    terms: Terms
    grid: Grid
    P: Array
    g: Array
    rss: Array
    c: Array

    @property
    def dof(self) -> int:
        return 3 * self.sheet.n - 12

    def each(self, rss: Array) -> Array:
        """Log likelihood and prior at every point for sums of squares (G, ...)."""
        shape = (-1,) + (1,) * (rss.ndim - 1)
        rss = np.maximum(rss, 1e-12)
        noise = np.sqrt(rss / self.dof)
        return self.c.reshape(shape) - 0.5 * self.dof * np.log(rss) + self.grid.prior(noise)

    def best(self, rss: Array) -> Array:
        """The largest log likelihood over the grid, (...)."""
        return np.asarray(self.each(rss).max(axis=0))

    @property
    def as_it_stands(self) -> float:
        return float(self.best(self.rss))

    @property
    def few(self) -> Index:
        """Points with as much scatter of both axes, on which many hypotheses are looked at first"""
        grid = self.grid
        return np.flatnonzero(
            np.isin(grid.inclination, _FEW)
            & (grid.inclination == grid.tool_face)
            & (grid.share > 0.0)
        )

    def at(self, points: Index) -> Base:
        """The same at some points of the grid only."""
        grid = self.grid
        some = Grid(grid.inclination[points], grid.tool_face[points], grid.share[points])
        return replace(
            self, grid=some, P=self.P[points], g=self.g[points], rss=self.rss[points],
            c=self.c[points],
        )  # fmt: skip


def base_of(sheet: Sheet) -> Base | None:
    """The base of a sheet; None where its rows cannot carry twelve parameters."""
    terms = terms_of(sheet)
    if 3 * sheet.n < 21 or np.linalg.matrix_rank(terms.design, 1e-6) < 12:
        return None
    grid = _grid(sheet.n)
    weight = np.repeat(1.0 / sheet.sigma, 3)
    X, E = weight[:, None] * terms.design, weight[:, None] * terms.beside
    i, t = weight[:, None] * terms.inclination, weight[:, None] * terms.tool_face
    V = np.eye(3 * sheet.n) + (
        (grid.inclination**2)[:, None, None] * (i @ i.T)
        + (grid.tool_face**2)[:, None, None] * (t @ t.T)
        + (grid.share**2)[:, None, None] * (E @ E.T)
    )
    W = np.linalg.inv(V)
    WX = W @ X
    A = X.T @ WX
    # The rows are weighted on the way in, so that changes of readings need no weights later.
    P = (W - WX @ np.linalg.solve(A, np.swapaxes(WX, 1, 2))) * np.outer(weight, weight)
    g = P @ sheet.reading.ravel()
    c = -0.5 * (np.linalg.slogdet(V)[1] + np.linalg.slogdet(A)[1])
    return Base(sheet=sheet, terms=terms, grid=grid, P=P, g=g, rss=g @ sheet.reading.ravel(), c=c)


def _grid(n: int) -> Grid:
    setting = _SETTING if n <= _FULL_GRID else _COARSE
    share = _SHARE if n <= _FULL_GRID else _SHARE[1:2]
    points = np.array([(i, t, k) for i in setting for t in setting for k in share])
    return Grid(*points.T)


def design_rows(truth: Array) -> Array:
    """(m, 3, 12) of truths (m, 3) mg: the sensor's matrix (unitless) and bias (mg)."""
    both = np.column_stack([truth, np.ones(len(truth))])
    return np.asarray(np.kron(both, np.eye(3)).reshape(-1, 3, 12), np.float64)


def beside_rows(gravity: float, i: Array, t: Array, turn: Array) -> Array:
    """(m, 3, 11): a degree of each error of the bench's dials, and squares of the response."""
    along_i, along_t = slopes(gravity, i, t)
    one = np.ones_like(i)
    dial = np.stack([one, i / (np.pi / 2.0), np.sin(i), np.cos(i), np.sin(t), np.cos(t)], axis=-1)
    rotary = np.stack([np.sin(t), np.cos(t)], axis=-1)
    c = np.cos(i)
    force = np.stack([c * np.sin(t), c * np.cos(t), np.sin(i)], axis=-1) @ turn.T
    squares = _SQUARES * np.eye(3) * (force**2)[:, None, :]
    return np.concatenate(
        [
            (along_i @ turn.T)[:, :, None] * dial[:, None],
            (along_t @ turn.T)[:, :, None] * rotary[:, None],
            squares,
        ],
        axis=2,
    )


def terms_of(sheet: Sheet) -> Terms:
    """The linear terms about the sensor's turn, which survives a few wrong rows."""
    truth, (i, t) = sheet.truth(), sheet.angles()
    design = np.column_stack([truth, np.ones(sheet.n)])
    found = np.linalg.lstsq(design, sheet.reading, rcond=1e-6)[0]
    u, _, v = np.linalg.svd(found[:3].T)
    turn = u @ v
    along_i, along_t = (a @ turn.T for a in slopes(sheet.gravity, i, t))
    return Terms(
        design_rows(truth).reshape(-1, 12),
        beside_rows(sheet.gravity, i, t, turn).reshape(3 * sheet.n, -1),
        _by_setting(along_i, sheet.inclination_setting),
        _by_setting(along_t, sheet.tool_face_setting),
        turn,
    )


def _by_setting(along: Array, setting: NDArray[np.intp]) -> Array:
    names, which = np.unique(setting, return_inverse=True)
    out = np.zeros((len(setting), 3, len(names)))
    out[np.arange(len(setting)), :, which] = along
    return out.reshape(3 * len(setting), -1)
