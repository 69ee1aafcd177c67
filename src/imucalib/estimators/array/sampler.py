"""The posterior of an array's positions by the fast sampler, and what it must not hide."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.core.eigen import eigen
from imucalib.errors import Undetermined
from imucalib.estimators.array.mode import Frame, laplace_frame, start_prior
from imucalib.estimators.array.problem import ArrayData, ArrayPrior
from imucalib.estimators.markov.convergence import Convergence, convergence
from imucalib.estimators.markov.hmc import Stop, sample

COLLAPSED = 0.5  # share of the drawing's extent below which a geometry is no longer believed
_CHAINS, _DRAWS = 4, 500  # independent draws where there is no chain
VAGUE = 0.05  # relative standard deviation of the array's size above which it is not determined


@dataclass(frozen=True)
class ArrayPositions:
    """Draws of the positions and what they come from.

    unknowns : (chains, n, size) positions (m), then Σ and the noise as in `ArrayPrior`
    frame : the mode and the Gaussian there; None for a chain that has none
    accepted, steps : of the sampler; convergence : of every unknown; sampler : its name
    """

    data: ArrayData
    prior: ArrayPrior
    unknowns: Array
    frame: Frame | None
    accepted: float
    steps: int
    convergence: Convergence
    sampler: str = "hmc"
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def draws(self) -> Array:
        """(chains, n, A, 3) m, triad 1 at zero."""
        c, n, _ = self.unknowns.shape
        return self.prior.geometry(self.unknowns.reshape(c * n, -1)).reshape(c, n, -1, 3)

    @property
    def free(self) -> Array:
        """(chains · n, 3 (A - 1)) m, one row a draw."""
        return self.unknowns[..., : self.prior.positions].reshape(-1, self.prior.positions)

    @property
    def mean(self) -> Array:
        """(A, 3) m, posterior mean."""
        return np.asarray(self.draws.mean(axis=(0, 1)))

    @property
    def sd(self) -> Array:
        """(A, 3) m; zero for triad 1, which is the origin."""
        return np.asarray(self.draws.std(axis=(0, 1), ddof=1))

    @property
    def covariance(self) -> Array:
        """(3 (A - 1), 3 (A - 1)) m²."""
        return np.asarray(np.cov(self.free.T))

    @property
    def scale(self) -> tuple[float, float]:
        """Size of the array over the drawing's (the regression on it), and its sd."""
        return scale_of(self.free, self.prior.nominal)

    @property
    def noise(self) -> float:
        """m/s², mean accelerometer standard deviation: declared times the estimated factor."""
        factor = np.exp(self.unknowns[..., -1]).mean() if self.prior.estimate_noise else 1.0
        return float(factor * np.sqrt(np.mean(self.data.sigma**2)))


def scale_of(free: Array, nominal: Array) -> tuple[float, float]:
    """Mean and sd over draws (n, 3 (A - 1)) of the projection on the nominal geometry."""
    drawn = (nominal[1:] - nominal[0]).ravel()
    values = free @ drawn / (drawn @ drawn)
    return float(values.mean()), float(values.std(ddof=1))


def sample_positions(
    data: ArrayData,
    prior: ArrayPrior,
    rng: np.random.Generator,
    *,
    chains: int | None = None,
    stop: Stop | None = None,
    checkpoint: Path | None = None,
) -> ArrayPositions:
    """Posterior of the positions; the scale of ω̇ that Σ is sought around is set from the data.

    Raises Undetermined when the motion does not hold the geometry or it collapses, NotConverged
    when the chains disagree.
    """
    chosen = start_prior(data, prior)
    frame = laplace_frame(data, chosen)
    refuse_collapse(chosen.geometry(frame.mode[None])[0], chosen.nominal)

    def target(z: Array) -> tuple[Array, Array]:
        value, gradient = frame.posterior.value_and_gradient(frame.place(z))
        return value - frame.value, gradient @ frame.root

    count = chains or (8 if data.samples < 300 else 4)
    found = sample(
        target, chosen.size, rng, chains=count, stop=stop, checkpoint=checkpoint, seen=frame.place
    )
    positions = ArrayPositions(
        data=data,
        prior=chosen,
        unknowns=frame.place(found.draws),
        frame=frame,
        accepted=found.accepted,
        steps=found.steps,
        convergence=found.convergence,
    )
    refuse_collapse(positions.mean, chosen.nominal)
    refuse_vague(positions)
    return positions


def gaussian_positions(
    data: ArrayData, prior: ArrayPrior, mean: Array, covariance: Array, rng: np.random.Generator
) -> ArrayPositions:
    """Independent draws of positions (d,) m with covariance (d, d) m², for IMUs on one line: the
    spin about it is in no reading, and a chain that learns its size would drift for ever.

    Raises as `sample_positions` does.
    """
    chosen = replace(prior, motion="flat", estimate_noise=False)
    white = rng.standard_normal((_CHAINS, _DRAWS, len(mean)))
    unknowns = mean + white @ np.linalg.cholesky(covariance).T
    found = ArrayPositions(
        data=data,
        prior=chosen,
        unknowns=unknowns,
        frame=None,
        accepted=1.0,
        steps=1,
        convergence=convergence(unknowns),
        sampler="gaussian",
        notes=("IMUs on one line: the spin about it stays open, positions by the joint fit alone",),
    )
    refuse_collapse(found.mean, chosen.nominal)
    refuse_vague(found)
    return found


def refuse_collapse(geometry: Array, nominal: Array) -> None:
    """Raise Undetermined when a geometry (A, 3) has shrunk along a direction of the drawing."""
    centred, drawn = geometry - geometry.mean(axis=0), nominal - nominal.mean(axis=0)
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
            "about all axes, or use the learned motion prior",
        )


def refuse_vague(positions: ArrayPositions) -> None:
    """Raise Undetermined when the motion leaves the array's size or most positions open."""
    scale, sd = positions.scale
    share = float(np.median(positions.sd[1:])) / positions.prior.sd
    if sd > VAGUE * scale or share > 0.5:
        raise Undetermined(
            f"too little rotation: the array's size is known to {100 * sd / scale:.1f} % and a "
            f"position to {100 * share:.0f} % of its prior uncertainty; most open is "
            f"{open_direction(positions.covariance)}",
            remedy="twist the array faster, about all axes, for longer; or use more samples",
        )


def open_direction(covariance: Array) -> str:
    """In words, the direction in space in which positions with covariance (d, d) are least known:
    of the least known combination of them, the axis that its IMUs share most."""
    shift = eigen(covariance)[1][:, -1].reshape(-1, 3)
    axis = np.linalg.svd(shift)[2][0]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    return "along (" + ", ".join(f"{v:.2f}" for v in axis + 0.0) + ") of the board"
