"""Positions as the chains draw them, and what they must not be asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.motion.density import PositionDensity
from imucalib.calibrators.array.motion.state import ArrayState
from imucalib.core.eigen import eigen
from imucalib.errors import Undetermined
from imucalib.estimators.markov.convergence import Convergence
from imucalib.estimators.markov.crank_nicolson import Stop, sample

COLLAPSED = 0.5  # share of the drawing's extent below which a geometry is no longer believed
VAGUE = 0.05  # relative standard deviation of the array's size above which it is not determined
OPEN = 0.5  # share of what was believed before, from which a direction is not shown


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
