"""Positions as chains draw them, over the joint fit or as published, and what they refuse."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.moving import Moving
from imucalib.calibrators.array.motion.state import ArrayState, refit_motion
from imucalib.core.eigen import eigen
from imucalib.errors import NotConverged, Undetermined
from imucalib.estimators.array.noise import MotionNoise
from imucalib.estimators.array.published import ArrayData, DrawnPrior, run_pmmh
from imucalib.estimators.array.samples import SPIN, inverse_roots
from imucalib.estimators.markov import Convergence, Stop, convergence, sample

COLLAPSED = 0.5  # share of the drawing's extent below which a geometry is no longer believed
VAGUE = 0.05  # relative standard deviation of the array's size above which it is not determined
OPEN = 0.5  # share of what was believed before, from which a direction is not shown
_READINGS = 1500  # samples times IMUs that are worked on at a time, within the processor's cache
_BATCH = 32  # positions at a time
_BENT = 0.75  # share of a weight that its fall along its own residual takes at most
_SETTLED = 4  # rounds of the motion with its weights, at the fit
#: Of each triad the columns (3 n, m) of its terms, and which of all they are.
_Terms = list[tuple[Array, Index]]
SAMPLES = 2000  # moving samples, where nobody says how many
#: The paper's rule: a data sheet's non-linearity, as a share of the accelerometers' range.
NON_LINEARITY = 0.005
_KEPT = 2000  # draws of a chain that are kept


@dataclass(frozen=True)
class PositionDraws:
    """free : (chains, n, d) m, draws of all positions but the first; accepted : share of the
    proposals; convergence : of these; sampler : its name; step : of its proposals, where it has
    one; notes : what a reader must know of it"""

    free: Array
    accepted: float
    convergence: Convergence
    sampler: str = "pcn"
    step: float = float("nan")
    notes: tuple[str, ...] = ()

    @property
    def draws(self) -> Array:
        """(chains, n, K, 3) m, the first IMU at zero."""
        chains, n, d = self.free.shape
        zero = np.zeros((chains, n, 1, 3))
        return np.concatenate([zero, self.free.reshape(chains, n, d // 3, 3)], axis=2)

    @property
    def sentence(self) -> str:
        """How good they are, in words."""
        return f"{100 * self.accepted:.0f} % of proposals accepted, {self.convergence.sentence}"

    @property
    def mean(self) -> Array:
        """(K, 3) m, posterior mean."""
        return np.asarray(self.draws.mean(axis=(0, 1)))

    @property
    def covariance(self) -> Array:
        """(d, d) m²."""
        return np.asarray(np.cov(self.free.reshape(-1, self.free.shape[2]).T))


def draw_positions(state: ArrayState, stop: Stop, rng: np.random.Generator) -> PositionDraws:
    """Chains over the density that a fit maximises, in the Gaussian that its curvature gives.

    Raises Undetermined where the motion does not hold the geometry, NotConverged where the chains
    disagree.
    """
    assert state.by_noise is not None
    d, board = state.positions, state.setup.board
    refuse_collapse(state.r, board.drawn)
    refuse_open(state.r, state.covariance[:d, :d], board)
    density, spread = PositionDensity(state), state.by_noise[:d, :d]
    size = np.sqrt(np.diag(spread))
    root = size[:, None] * np.linalg.cholesky(spread / np.outer(size, size))
    start = state.r[1:].ravel()

    def place(z: Array) -> Array:
        return np.asarray(start + z @ root.T)

    found = sample(lambda z: density(z @ root.T), d, rng, stop=stop, seen=place)
    return PositionDraws(
        free=place(found.draws),
        accepted=found.accepted,
        convergence=found.convergence,
        step=found.step,
    )


def refuse_collapse(geometry: Array, drawn: Array) -> None:
    """Raise Undetermined when a geometry (A, 3) has shrunk along a direction of the drawing."""
    centred, drawn = geometry - geometry.mean(axis=0), drawn - drawn.mean(axis=0)
    _, values, axes = np.linalg.svd(drawn, full_matrices=False)
    wide = values > 1e-6
    # Sorted extents: a square has no axes of its own along which to look for the short side.
    extent = np.linalg.svd(centred @ axes[wide].T, compute_uv=False) / values[wide]
    least = float(extent.min(initial=np.inf))
    if least < COLLAPSED:
        raise Undetermined(
            f"the geometry collapses: along one direction {100 * least:.0f} % of the drawing is "
            "left, although the chains would agree",
            remedy="too little rotation for the accelerometers' noise: twist the array faster, "
            "about all axes",
        )


def refuse_open(r: Array, covariance: Array, board: Board) -> None:
    """Raise Undetermined when the motion leaves the array's size or a direction open.

    r : (K, 3) m; covariance : (d, d) m²
    """
    scale, sd = size_over(board.drawn, r, covariance)
    sizes, axes = rank_directions(covariance)
    share = float(sizes[-1]) / board.prior_sd
    if sd > VAGUE * scale or share > OPEN:
        raise Undetermined(
            f"too little rotation: the array's size is known to {100 * sd / scale:.1f} % and "
            f"positions {along(axes[:, -1])} to {100 * share:.0f} % of their prior uncertainty",
            remedy="twist the array faster, about all axes, for longer; or use more samples",
        )


def size_over(drawn: Array, r: Array, covariance: Array) -> tuple[float, float]:
    """Size of positions r (K, 3) m over that of the drawing (the regression on it), and its sd."""
    own = (drawn[1:] - drawn[0]).ravel()
    row = own / (own @ own)
    return float(row @ r[1:].ravel()), float(np.sqrt(row @ covariance @ row))


def rank_directions(covariance: Array) -> tuple[Array, Array]:
    """How well a motion shows the three directions in space, the best shown one first: sd (3,) m,
    rms over the IMUs, and the directions in the columns of (3, 3).

    covariance : (d, d) m² of all positions but the first
    """
    count = len(covariance) // 3
    mean = np.einsum("kikj->ij", covariance.reshape(count, 3, count, 3)) / count
    values, axes = eigen(mean)
    return np.sqrt(np.maximum(values, 0.0)), axes


def along(axis: Array) -> str:
    """A direction of the board, in words."""
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    return "along (" + ", ".join(f"{v:.2f}" for v in axis + 0.0) + ") of the board"


class PositionDensity:
    """What the joint fit maximises: of steps (B, d) m of the positions from a fitted state, log p
    (B,) over that of the fit itself,

        log p(x) = - Σ (ν + 3)/2 log(1 + |e|²/(ν σ²)) - Σ (x - prior)²/2 sd²,

    with e = y - motion - terms of all triads and samples (for Gaussian noise Σ |e|²/2 σ²). The
    nine unknowns of each sample are at their best for x: equations 4 and 5 of paper 001, whose flat
    integral over dω/dt pulls positions to the drawing's middle, while the best motion does not.
    Noise, and what places scatter by about the drawing, are those of the fit; effects are linear
    about it and at their best for x, positions and motion are not linear.
    """

    def __init__(self, state: ArrayState) -> None:
        assert state.by_noise is not None
        d, spread = state.positions, state.by_noise
        # What the effects follow of a step of the positions, in the Gaussian of the curvature.
        self._follow = np.linalg.solve(spread[:d, :d], spread[:d]).T
        state = refit_motion(state, _SETTLED)
        base, inner = state.base, state.setup.inner
        self._turn, self._prior, self._r = base.turn, base.prior, state.r
        self._start = base.pull / base.prior
        some = max(_READINGS // state.setup.board.count, 1)
        raw = self._turn @ self._follow
        self._parts = [
            _part_of(state, inner[a : a + some], raw) for a in range(0, len(inner), some)
        ]
        self._level = float(self._of(np.zeros((1, d)))[0])

    def __call__(self, step: Array) -> Array:
        parts = [self._of(step[a : a + _BATCH]) for a in range(0, len(step), _BATCH)]
        return np.concatenate(parts) - self._level

    def _of(self, step: Array) -> Array:
        whole = step @ self._follow.T
        raw = self._turn @ whole.T
        r = self._r[..., None] + raw[: self._r.size].reshape(*self._r.shape, -1)
        value = -0.5 * np.sum(self._prior * (self._start + whole) ** 2, axis=1)
        for part in self._parts:
            value += part.log(r, step, raw[self._r.size :])
        return np.asarray(value)


@dataclass(frozen=True)
class _Part:
    """n samples. x : (n, 9) their fitted motion; follow : (n, 9, d) what it follows of a step of
    the positions; read : (n, K, 3) forces and rates less the terms; variances : (n, K); terms : of
    both sensors; noise"""

    x: Array
    follow: Array
    read: tuple[Array, Array]
    variances: tuple[Array, Array]
    terms: tuple[_Terms, _Terms]
    noise: tuple[MotionNoise, MotionNoise]

    def log(self, r: Array, step: Array, raw: Array) -> Array:
        """(B,) at positions r (K, 3, B), which are steps (B, d) away, and steps of the terms'
        columns (R, B)."""
        x = self.x[..., None] + self.follow @ step.T
        rate, spin = x[:, 6:], x[:, 3:6]
        turn = rate[:, :, None] * rate[:, None]
        turn[:, range(3), range(3)] -= np.sum(rate * rate, axis=1)[:, None]
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            turn[:, j, i] += spin[:, k]
            turn[:, i, j] -= spin[:, k]
        value = -0.5 * SPIN * np.sum(spin**2, axis=(0, 1))
        for k, of_motion in enumerate((np.einsum("tijb,kjb->tkib", turn, r), 0.0)):
            off = of_motion + _add_terms(self.terms[k], raw)
            off += (x[:, None, :3], x[:, None, 6:])[k]
            off -= self.read[k][..., None]
            square = np.einsum("tkib,tkib->tkb", off, off) / self.variances[k][..., None]
            nu = self.noise[k].freedom
            if np.isfinite(nu):
                # One logarithm a sample: they are most of the work otherwise.
                each = np.log(np.prod(1.0 + square / nu, axis=1))
                value -= 0.5 * (nu + 3.0) * np.sum(each, axis=0)
            else:
                value -= 0.5 * np.sum(square, axis=(0, 1))
        return np.asarray(value)


def _part_of(state: ArrayState, rows: Index, raw: Array) -> _Part:
    """raw : (R, d) steps of all columns a step of the positions."""
    own, k = state.sampled.take(rows), state.setup.board.count
    speed = np.linalg.norm(own.rate, axis=1)
    variances = (state.noise[0].variance(speed), state.noise[1].variance(speed))
    terms = list(_columns(state, rows, gyro=False)), list(_columns(state, rows, gyro=True))
    moved = raw[: 3 * k].reshape(k, 3, -1)
    force = np.einsum("tij,kjd->tkid", own.turn, moved) + _add_terms(terms[0], raw[3 * k :])
    rate = _add_terms(terms[1], raw[3 * k :])
    # Second derivatives: a weight falls along its own residual.
    slopes = own.arms, np.broadcast_to(np.eye(9)[6:], (len(rows), k, 3, 9))
    bent = [
        _curve_weights(slope, off, variance, noise)
        for slope, off, variance, noise in zip(slopes, own.off, variances, state.noise, strict=True)
    ]
    inner = sum(np.einsum("tkim,tkin->tmn", a, b) for a, b in zip(slopes, bent, strict=True))
    inner[:, range(3, 6), range(3, 6)] += SPIN
    pull = sum(
        np.einsum("tkim,tkid->tmd", b, c, optimize=True)
        for b, c in zip(bent, (force, rate), strict=True)
    )
    with np.errstate(invalid="ignore"):
        root = inverse_roots(inner)
    open_ = ~np.isfinite(root).all(axis=(1, 2))
    root[open_] = own.root[open_]
    return _Part(
        x=np.concatenate([own.origin, own.spin, own.rate], axis=1),
        follow=-np.matmul(root, np.matmul(root.transpose(0, 2, 1), pull)),
        read=(own.force + own.off.acceleration, own.rate[:, None] + own.off.rate),
        variances=variances,
        terms=terms,
        noise=state.noise,
    )


def _curve_weights(slope: Array, off: Array, variance: Array, noise: MotionNoise) -> Array:
    """(n, K, 3, 9) derivatives by the motion of weighted residuals off (n, K, 3), whose own
    derivatives are slope."""
    nu = noise.freedom
    if not np.isfinite(nu):
        return np.asarray(slope / variance[..., None, None])
    square = np.sum(off * off, axis=2)
    whole = nu * variance + square
    # Along a far residual a weight's second derivative is negative: no sample answers to that.
    bend = np.minimum(2.0 / whole, _BENT / np.maximum(square, 1e-300))[..., None, None]
    along = np.einsum("tki,tkim->tkm", off, slope)[:, :, None] * off[..., None]
    return np.asarray((nu + 3.0) / whole[..., None, None] * (slope - bend * along))


def _add_terms(terms: _Terms, raw: Array) -> Array:
    """(n, K, 3, B) what terms add to one kind of sensor."""
    made = [(own @ raw[which]).reshape(len(own) // 3, 3, raw.shape[1]) for own, which in terms]
    return np.stack(made, axis=1)


def _columns(state: ArrayState, rows: Index, *, gyro: bool) -> Iterator[tuple[Array, Index]]:
    """Of each triad the columns of its terms, and which of all raw ones they are."""
    blocks = state.base.blocks[1:]
    starts = np.cumsum([0, *(block.size for block in blocks)])
    mine = [(b, start) for b, start in zip(blocks, starts, strict=False) if b.gyro is gyro]
    for triad in range(state.setup.board.count):
        own = [b.basis[triad, rows].reshape(3 * len(rows), -1) for b, _ in mine]
        which = [start + b.of(triad) for b, start in mine]
        if own:
            yield np.concatenate(own, axis=1), np.concatenate(which)
        else:
            yield np.empty((3 * len(rows), 0)), np.empty(0, np.intp)


def draw_as_published(
    moving: Moving,
    board: Board,
    rng: np.random.Generator,
    *,
    samples: int | None,
    iterations: int,
    stop: Stop,
) -> PositionDraws:
    """Positions by paper 001's own procedure: its prior, its noise and its chain on plain samples.

    samples : at most, or None for `SAMPLES`; iterations : of Algorithm 1; stop : what its chains
    must reach
    Raises Undetermined where the board file lacks what it needs, or the positions collapse or stay
    open, NotConverged where its chains disagree.
    """
    count = min(samples or SAMPLES, len(moving.good))
    rows = moving.good[np.linspace(0, len(moving.good) - 1, count).round().astype(np.intp)]
    data = samples_of(moving, rows, board)
    prior = DrawnPrior(board.drawn, board.prior_sd)
    found = run_pmmh(data, prior, rng, iterations=iterations)
    checked = convergence(found.draws)
    if not checked.is_reached(stop.rhat, stop.ess):
        raise NotConverged(
            f"the chains of Algorithm 1 do not agree after {iterations} iterations: "
            f"{checked.sentence}",
            remedy="more --iterations, or leave --as-published out",
        )
    drawn = found.draws[:, :: max(1, iterations // _KEPT)]
    notes = (
        f"Algorithm 1: N = {found.monte_carlo}, variance of the log likelihood "
        f"{found.variance:.2g}, burn-in {found.burn_in}",
    )
    positions = PositionDraws(drawn, found.accepted, checked, "pmmh", notes=notes)
    refuse_collapse(positions.mean, board.drawn)
    refuse_open(positions.mean, positions.covariance, board)
    size, sd = size_over(board.drawn, positions.mean, positions.covariance)
    pull = 3.0 * data.samples * (sd / size) ** 2
    note = (
        f"the flat prior on the angular acceleration shrinks the array by about {100 * pull:.2g} % "
        f"of its size, {pull * size / sd:.1f} of its stated sd"
    )
    return replace(positions, notes=(*notes, note))


def samples_of(moving: Moving, rows: Index, board: Board) -> ArrayData:
    """Rows of the moving part with the paper's noise: accelerometers by their non-linearity, gyros
    by the scatter of each sample over the triads (equation (30b)).

    Raises Undetermined where the board file does not state the accelerometers' range.
    """
    if not np.isfinite(board.accelerometer_range):
        raise Undetermined(
            "the paper's noise is a share of the accelerometers' range",
            remedy="state accelerometer_range (g) in the board file",
        )
    gyros, rate = moving.gyros, moving.levelled.rate[rows]
    off = rate - rate.mean(axis=1, keepdims=True)
    each = np.einsum("nki,nkj->nij", off, off) / (gyros.triads - 1)
    # What three scattered axes of few gyros show may have no rank.
    doubt = each + 1e-3 * np.trace(gyros.covariance) / 3.0 * np.eye(3)
    sigma = np.full(board.count, NON_LINEARITY * board.accelerometer_range)
    return ArrayData(moving.acceleration[rows], sigma, gyros.mean[rows], np.linalg.inv(doubt))
