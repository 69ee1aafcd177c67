"""A generic bench for tests: positions all over the sphere, every covariate there is."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector, Reference, unit_vector
from imucalib.effects import named
from imucalib.units import DEG, MG

GRAVITY = 9.8061
BASE = ("mounting", "bias", "scale", "non_orthogonality")
NINE = ("bias", "scale", "non_orthogonality")
SETTINGS = KnownVector.COMPONENTS
SIGMA = 0.3 * MG
#: Readings of 0.3 mg on a bench whose settings err by 0.02 and 0.03 degrees.
NOISE = Noise(1.0, SETTINGS, (0.02 * DEG, 0.03 * DEG))
QUIET = Noise(1.0)


def base_model(names: tuple[str, ...] = BASE) -> Model:
    return Model(tuple(named(name) for name in names))


def directions(n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Inclination within 75 degrees of level and tool-face over the turn, rad, spread evenly."""
    share = (np.arange(n) + 0.5) / n
    inclination = np.arcsin(0.965 * (2.0 * rng.permutation(share) - 1.0))
    return inclination, 2.0 * np.pi * rng.permutation(share)


def context_of(inclination: Array, tool_face: Array, rng: np.random.Generator) -> Context:
    """Every covariate of the catalogue, each independent of the others."""
    n = len(inclination)
    before = GRAVITY * unit_vector(np.roll(inclination, 1), np.roll(tool_face, 1))
    side = np.sign(GRAVITY * unit_vector(inclination, tool_face) - before)
    covariates = {
        "record": np.arange(n, dtype=float),
        "order": np.linspace(0.0, 1.0, n),
        "time": np.linspace(0.0, 3600.0, n),
        "temperature": 25.0 + rng.permutation(np.linspace(-12.0, 12.0, n)),
        "time_of_day": 2.0 * np.pi * (0.618 * np.arange(n) % 1.0),
        "inclination": inclination,
        "tool_face": tool_face,
        "sweep": np.floor(4.0 * np.arange(n) / n),
        "inclination_approach": np.sign(rng.permutation(n) - n / 2 + 0.5),
        "tool_face_approach": np.sign(rng.permutation(n) - n / 2 + 0.5),
        **{f"previous_{axis}": before[:, k] for k, axis in enumerate("xyz")},
        **{f"approach_{axis}": side[:, k] for k, axis in enumerate("xyz")},
    }
    return Context(n, covariates, sweeps=4)


def bench(seed: int, n: int = 60, *, shared: bool = False, exact: bool = False) -> Observations:
    """A bench with known angles and no readings yet (they are the nominal truth).

    shared : rows come in fives that hold one inclination; exact : angles without errors
    """
    rng = np.random.default_rng(seed)
    inclination, tool_face = directions(n, rng)
    i_set = np.arange(n, dtype=np.intp)
    if shared:
        i_set = i_set // 5
        inclination = inclination[i_set]
    reference = KnownVector(
        inclination, tool_face, GRAVITY, i_set, np.arange(n, dtype=np.intp), not exact
    )
    return _blank(reference, context_of(inclination, tool_face, rng))


def tumble(seed: int, n: int = 60) -> Observations:
    """The same attitudes where only the size of gravity is known."""
    known = bench(seed, n)
    blank = _blank(KnownNorm(n, GRAVITY), known.context)
    return blank.set_reading(known.reading)


def _blank(reference: Reference, context: Context) -> Observations:
    n = context.n
    eta = np.zeros(reference.eta_size)
    if isinstance(reference, KnownNorm):
        eta = np.tile([0.0, 0.0, 1.0], n)
    label = tuple(f"row {k + 1}" for k in range(n))
    sigma = np.full((n, 1, 3), SIGMA)
    return Observations(reference.truth(eta), sigma, reference, context, np.arange(n), label)


def draw(model: Model, theta: Array, observations: Observations, seed: int) -> Observations:
    """Readings with this bench's noise."""
    known = isinstance(observations.reference, KnownVector) and (
        observations.reference.setting_errors
    )
    noise = NOISE if known else QUIET
    return simulate(model, theta, observations, noise, np.random.default_rng(seed))


def ordinary_theta(model: Model, observations: Observations, seed: int) -> Array:
    """Parameters as large as one expects them."""
    typical = np.array([p.typical for p in model.parameters(observations.context)])
    return np.clip(np.random.default_rng(seed).standard_normal(typical.size), -2.0, 2.0) * typical


def simulate(
    model: Model,
    theta: Array,
    observations: Observations,
    noise: Noise,
    rng: np.random.Generator,
) -> Observations:
    """Draw new readings for the reference and context of `observations`: the model run forwards.

    The settings' errors are drawn with the components' standard deviations and shared as the
    reference says; a reference without components keeps its truth at `start` of the readings.
    """
    reference, context = observations.reference, observations.context
    eta = reference.start(observations.reading)
    directions = reference.directions(eta)
    if any(directions.component):
        for column, component in enumerate(directions.component):
            sd = noise.sd[noise.component.index(component)] if component else 0.0
            used = np.unique(directions.index[:, column])
            eta[used] = sd * rng.standard_normal(used.size)
    clean = model.predict(theta, reference.truth(eta), context).reading
    spread = noise.factor * observations.sigma
    return observations.set_reading(clean + spread * rng.standard_normal(clean.shape))
