"""An array's rests as observations: what each shows, and how much it counts.

A rest's mean is as good as its samples are many, down to what a chip's offset does from rest to
rest. A rest of one second between rests of half a minute is five times as noisy, and an error of
the model that is only its noise would be searched for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.frame import framed_misalignment
from imucalib.core.balance import Noise, balance
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects import named
from imucalib.errors import Undetermined
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.variance import estimate_noise
from imucalib.rests.segments import Segments
from imucalib.units import MG

FEWEST_POSES = 9
#: What differs from rest to rest beside the averaged noise, in units of that of a median rest, as
#: tried.
_BETWEEN = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
#: Share of the median axis' noise below which rounding, which does not average, is all there is.
_QUIET = 0.1


def base_model() -> Model:
    """Bias, scale and misalignment of every triad, in the frame that is their mean."""
    return Model((named("bias"), named("scale"), framed_misalignment()))


def rest_context(t: Array, start: float, stop: float, triads: tuple[str, ...]) -> Context:
    """What effects know at times (N,) s: the order runs from 0 at the first rest to 1 at the last,
    and no further. No record is one of the rests'."""
    order = np.clip((t - start) / max(stop - start, 1e-9), 0.0, 1.0)
    covariates = {"order": order, "time": t, "record": np.full(len(t), -1.0)}
    return Context(len(t), covariates, triads)


def observations_of(
    segments: Segments, board: Board, order: list[int], gravity: float
) -> Observations:
    """One observation a rest, in order of time; sigma is that of no weights yet, 1 mg for all.

    Raises Undetermined where there are too few, or where an IMU reads another unit.
    """
    n = segments.n
    if n < FEWEST_POSES:
        raise Undetermined(
            f"{n} rests found, at least {FEWEST_POSES} are needed to calibrate the accelerometers",
            remedy="hold the board still in nine or more attitudes; `imucal inspect FILE --rests` "
            "lists what counts as a rest and what was refused",
        )
    reading = segments.mean[:, order]
    ratio = np.median(np.linalg.norm(reading, axis=2), axis=0) / gravity
    worst = int(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-9)))))
    if not 0.5 < ratio[worst] < 2.0:  # offsets do not double or halve gravity
        raise Undetermined(
            f"{board.imus[worst]} reads {ratio[worst]:.2g} times gravity at rest",
            remedy="its unit is not what the recording or its mapping says (g against m/s²: 9.81)",
        )
    middle = 0.5 * (segments.start + segments.stop)
    known = rest_context(middle, float(middle[0]), float(middle[-1]), board.imus)
    covariates = {**known.covariates, "record": np.arange(float(n))}
    return Observations(
        reading,
        np.full(reading.shape, MG),
        KnownNorm(n, gravity, board.rotations),
        replace(known, covariates=covariates, attitude=board.rotations),
        np.arange(n),
        tuple(f"rest {k + 1} ({t:.0f} s)" for k, t in enumerate(middle)),
    )


def own_noise(segments: Segments, order: list[int]) -> Array:
    """(n, K, 3) m/s², what its samples' noise and their rounding leave of each rest's mean."""
    noise = np.maximum(segments.noise[order], _QUIET * np.median(segments.noise[order]))
    averaged = noise / np.sqrt(segments.samples[:, order])[..., None]
    return np.hypot(averaged, rounding(segments.step[order], segments.noise[order]))


def rounding(step: Array, noise: Array, *, alike: bool = False) -> Array:
    """Standard deviation of what rounding to a step leaves of the mean of however many samples, by
    the noise that they show; the harmonics of the saw-tooth that rounding is, of which noise of
    half a step leaves nothing (Widrow and Kollar, Quantization Noise, 2008, chapter 4).

    alike : whether all rests read the same: between two steps rounding alone makes noise of a half
    """
    below = np.maximum(noise**2 - step**2 / (4.0 if alike else 12.0), 0.0)
    ratio = 4.0 * np.pi**2 * below / np.maximum(step, 1e-100) ** 2
    k = np.arange(1.0, 41.0)
    harmonics = np.exp(-ratio[..., None] * k**2) / k**2
    return np.asarray(step * np.sqrt(harmonics.sum(axis=-1) / 2.0) / np.pi)


def weighted(data: Observations, own: Array) -> Observations:
    """The same observations with sigma² = own² + between², up to the factor that every fit has.

    own : (n, K, 3) m/s². `between` is the likeliest of a few sizes (restricted likelihood of the
    model at its fit) beside a warm-up, whose misfit all rests share and which would pass for it.
    """
    found = fit_model(Model((*base_model().effects, named("warm_up"))), data)

    def likelihood(sigma: Array) -> float:
        at = balance(found.model, found.theta, found.eta, replace(data, sigma=sigma))
        noise = estimate_noise(at, Noise(1.0, at.component, ()), fixed=False)
        # What is left of a rest's numbers has two fewer directions: those of gravity.
        turned = np.log(np.mean(sigma**-2.0, axis=(1, 2)))
        return noise.log_likelihood - float(np.log(sigma).sum() + turned.sum())

    sizes = (size * float(np.median(own)) for size in _BETWEEN)
    return replace(data, sigma=max((np.hypot(own, size) for size in sizes), key=likelihood))
