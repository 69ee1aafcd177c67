"""What several calibrations have in common, as numbers with a full covariance each, and whether
they agree, in per cent.

Where all hold the same parameters, these. Where they hold other effects, what they do to first
order: the linear map reading = S force + c that is nearest to theirs over all attitudes, with its
frame (S row by row) where all tie a frame to a tool or none does, else without it (lengths of S's
rows, angles between them).

All have their parameters in common, unless one differs in a kind of them, or all scatter more than
they state: the posterior of `closed_loop.changes`, with the covariance of each file as well known
as its noise, and what power-ups bring as one part for all.

What a difference between calibrations means: the first calibration's reading of gravity in every
attitude, f(u) = g u, is corrected by the other. Its size may be compared always, its direction
where both mean the same frame. Standard deviations carry the full covariances of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag

from imucalib.arrays import Array
from imucalib.calibration.calibration import (
    NEVER_APPLIED,
    Calibration,
    linear_numbers,
    linear_slopes,
)
from imucalib.calibration.checking.noise import KNOWN
from imucalib.core.references import tangents
from imucalib.core.sphere import even_directions
from imucalib.estimators.power_ups import estimate_excess, fit_line
from imucalib.posterior.closed_loop.changes import (
    ChangeAnswer,
    ChangeQuestion,
    CovariancePart,
    Suspect,
)
from imucalib.units import DEG, MG

_ATTITUDES = 400
_ROUNDING = 1e-9  # mg, deg, or parts of one: what moves by less is touched by no parameter
#: Stated standard deviations of a parameter that readings of it show, and the share of a variance
#: that keeps a parameter without any from being certain.
_SHOWN, _LEAST = 5.0, 1e-9


@dataclass(frozen=True)
class DirectionErrors:
    """m calibrations in n attitudes, against the first. attitude : (n, 3) unit vectors
    size : (m, n) mg, of |f|; size_sd : (m, n) mg, of each one's own
    turn : (m, n, 2) deg, along two tangents; turn_covariance : (m, n, 2, 2) of each one's own
    """

    attitude: Array
    size: Array
    size_sd: Array
    turn: Array
    turn_covariance: Array

    @property
    def largest_sd(self) -> tuple[float, float]:
        """The largest stated sd of any calibration in any attitude: of |f| in mg, of the direction
        in deg."""
        turn = np.linalg.eigvalsh(self.turn_covariance)[..., -1]
        return float(self.size_sd.max()), float(np.sqrt(turn.max()))


@dataclass(frozen=True)
class Worst:
    """The largest difference of a pair. pair : numbers of the calibrations; value, sd : in `unit`;
    attitude : (3,) unit vector of the specific force; sensor : IMU of an array; limit : what of it
    matters"""

    pair: tuple[int, int]
    value: float
    sd: float
    unit: str
    attitude: Array
    sensor: str = ""
    limit: float = np.inf

    @property
    def beyond(self) -> bool:
        return self.value > self.limit


def direction_errors(
    calibrations: Sequence[Calibration], imu: int | None, gravity: float
) -> DirectionErrors:
    """imu : number of an array's IMU, None of one accelerometer; gravity : m/s²"""
    attitude = even_directions(_ATTITUDES)
    across = tangents(attitude)
    truth = gravity * attitude
    first, size, size_sd, turn, spread = calibrations[0], [], [], [], []
    if imu is None:
        model, theta = first.model()
        context = first.context(len(truth))
        reading = model.predict(theta, truth[:, None], context).reading[:, 0]
    else:
        reading = first.triads[imu].reading(truth)
    for one in calibrations:
        if imu is None:
            context = one.context(len(truth))
            force = one.apply(reading, context, unit="m/s2")
            own = one.force_covariance(truth, context)
        else:
            force = one.triads[imu].force(reading)
            own = one.triads[imu].force_covariance(truth)
        size.append((np.linalg.norm(force, axis=1) - gravity) / MG)
        size_sd.append(np.sqrt(np.einsum("ni,nij,nj->n", attitude, own, attitude)) / MG)
        turn.append(np.einsum("ni,nik->nk", force, across) / gravity / DEG)
        spread.append(np.einsum("nik,nij,njl->nkl", across, own, across) / (gravity * DEG) ** 2)
    return DirectionErrors(
        attitude, np.array(size), np.array(size_sd), np.array(turn), np.array(spread)
    )


def worst_pair(m: int, away: Callable[[int, int], Array]) -> tuple[tuple[int, int], float, int]:
    """Of all pairs of m: the one with the largest of what `away` gives, that, and its place."""
    every = {pair: away(*pair) for pair in combinations(range(m), 2)}
    pair = max(every, key=lambda one: (float(every[one].max()), one))
    return pair, float(every[pair].max()), int(every[pair].argmax())


def worst_size(found: DirectionErrors) -> Worst:
    """Of |f|, over all pairs and attitudes."""
    size, sd = found.size, found.size_sd
    pair, value, at = worst_pair(len(size), lambda i, j: np.abs(size[j] - size[i]))
    return Worst(pair, value, float(np.hypot(*sd[list(pair), at])), "mg", found.attitude[at])


def worst_turn(found: DirectionErrors) -> Worst:
    """Of the direction, over all pairs and attitudes; sd along the difference."""
    worst, at = worst_vector(found.turn, found.turn_covariance, "deg")
    return replace(worst, attitude=found.attitude[at])


def worst_vector(vectors: Array, covariance: Array, unit: str) -> tuple[Worst, int]:
    """Of vectors (m, n, k) with covariances (m, n, k, k), over all pairs, its sd and its attitude
    along the difference; and which of the n it is."""
    pair, value, at = worst_pair(
        len(vectors), lambda i, j: np.asarray(np.linalg.norm(vectors[j] - vectors[i], axis=1))
    )
    along = (vectors[pair[1], at] - vectors[pair[0], at]) / max(value, 1e-300)
    both = covariance[list(pair), at].sum(axis=0)
    return Worst(pair, value, float(np.sqrt(along @ both @ along)), unit, along), at


@dataclass(frozen=True)
class PowerUps:
    """share : of each covariance, what power-ups bring; dof : of its scale, one for all"""

    share: Sequence[Array]
    dof: float


@dataclass(frozen=True)
class Basis:
    """p numbers of m calibrations. value : (m, p); covariance : (m, p, p); dof : (m,) of each
    covariance's scale; words : what the numbers are, one sentence
    power_ups : of the covariances, None where nothing tells what they bring
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    covariance: Array
    dof: Array
    words: str
    power_ups: PowerUps | None = None


def basis_of(
    calibrations: Sequence[Calibration],
    dof: Array,
    *,
    framed: bool,
    power_ups: PowerUps | None = None,
) -> Basis:
    """framed : whether all tie a frame to a tool, or none does and all mean the same frame
    power_ups : of the calibrations' own covariances"""
    # What acts on a reading; of an array, its positions.
    at = [
        [k for k, p in enumerate(c.parameters) if p.stage not in NEVER_APPLIED or c.triads]
        for c in calibrations
    ]
    pairs = list(zip(calibrations, at, strict=True))
    own = [[(c.parameters[k].name, c.parameters[k].unit) for k in ks] for c, ks in pairs]
    shares = [np.zeros_like(c.covariance) for c in calibrations]
    shares = shares if power_ups is None else list(power_ups.share)
    same = all(one == own[0] for one in own[1:])
    if same:
        value = [np.array([c.parameters[k].value for k in ks]) for c, ks in pairs]
        slopes = [np.eye(len(c.parameters))[ks] for c, ks in pairs]
        names, units = zip(*own[0], strict=True)
        words = "All hold the same parameters."
    else:
        every = [_linear(c, framed=framed) for c in calibrations]
        value, slopes = [one for one, _ in every], [slope for _, slope in every]
        names, units = _linear_names(framed)
        words = (
            f"They hold different effects ({_only(own)}): compared is what they do to first "
            f"order, reading = S force + c{'' if framed else ', free of the frame'}."
        )

    def carry(every: Sequence[Array]) -> Array:
        return np.array([s @ one @ s.T for s, one in zip(slopes, every, strict=True)])

    covariance, share = carry([c.covariance for c in calibrations]), carry(shares)
    largest = np.einsum("kii->ki", covariance).max(axis=0)
    touched = np.flatnonzero((largest > _ROUNDING**2) | same)
    both = np.ix_(np.arange(len(own)), touched, touched)
    return Basis(
        names=tuple(names[k] for k in touched),
        units=tuple(units[k] for k in touched),
        value=np.array(value)[:, touched],
        covariance=covariance[both],
        dof=dof,
        words=words,
        power_ups=power_ups and replace(power_ups, share=list(share[both])),
    )


def _only(own: Sequence[Sequence[tuple[str, str]]]) -> str:
    """What not all of them hold."""
    every = [{name for name, _ in names} for names in own]
    some = sorted(name for name in set.union(*every) if not all(name in names for names in every))
    more = f", and {len(some) - 4} more" if len(some) > 4 else ""
    return f"not in all: {', '.join(some[:4])}{more}" if some else "other units"


def _linear_names(framed: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the numbers of `_linear`."""
    offsets = tuple(f"offset_{a}" for a in "xyz")
    if framed:
        gains = tuple(f"S_{a}{b}" for a in "xyz" for b in "xyz")
        return (*offsets, *gains), ("mg",) * 3 + ("1",) * 9
    shape = (*(f"scale_{a}" for a in "xyz"), "angle_xy", "angle_xz", "angle_yz")
    return (*offsets, *shape), ("mg",) * 3 + ("1",) * 3 + ("deg",) * 3


def _linear(calibration: Calibration, *, framed: bool) -> tuple[Array, Array]:
    """The numbers (q,) of one calibration, and their derivatives (q, p) by all of its parameters.

    Every direction has its opposite: what is even in the force is none of S.
    """
    half = even_directions(60)
    force = calibration.gravity * np.concatenate([half, -half])
    model, theta = calibration.model()
    acts = model.predict(theta, force[:, None], calibration.context(len(force)))
    operator = np.linalg.pinv(np.concatenate([np.ones((len(force), 1)), force], axis=1))
    # c over Sᵀ (4, 3), and its derivatives (4, 3, p); then S, rows first, and c.
    fitted = operator @ acts.reading[:, 0]
    moved = np.einsum("an,nip->aip", operator, acts.d_theta[:, 0])
    slope = np.concatenate([np.swapaxes(moved[1:], 0, 1).reshape(9, -1), moved[0]])
    wanted = ("bias_mg", "S") if framed else ("bias_mg", "scale", "angle")
    numbers, slopes = (
        linear_numbers(fitted[1:].T, fitted[0]),
        linear_slopes(fitted[1:].T, fitted[0]),
    )
    whole = np.zeros((sum(numbers[n].size for n in wanted), len(calibration.parameters)))
    whole[:, calibration.places(model)] = np.concatenate([slopes[n] for n in wanted]) @ slope
    return np.concatenate([numbers[n].ravel() for n in wanted]), whole


@dataclass(frozen=True)
class Agreement:
    """mean, mean_sd : (p,) of all; z : (m, p) of each against the mean of the others, by its whole
    sd; chi2, dof : that all agree; answer : what differs, by `suspect`"""

    mean: Array
    mean_sd: Array
    z: Array
    chi2: float
    dof: int
    answer: ChangeAnswer

    @property
    def z_rms(self) -> float:
        """1 where the scatter is what is stated."""
        return float(np.sqrt(self.chi2 / self.dof))

    @property
    def odd(self) -> tuple[int, ...]:
        """Files that differ from the others in the likeliest explanation, where they do; none of
        two, of which either may."""
        if not self.answer.told or len(self.z) < 3:
            return ()
        names = self.answer.likeliest.names
        return tuple(k for k in range(len(self.z)) if any(_is_of(k, name) for name in names))

    def differs(self, file: int) -> float:
        """Probability that a file differs from the others."""
        holds = self.answer.probability_that
        return holds(lambda names: any(_is_of(file, name) for name in names))

    def differs_in(self, kind: str) -> float:
        """Probability that a kind of parameters differs, in any file."""
        start = suspect(kind, "")
        return self.answer.probability_that(
            lambda names: any(name.startswith(start) for name in names)
        )


@dataclass(frozen=True)
class ParameterScatter:
    """Standard deviation between calibrations beyond their own, (p,) each, with its 95 % interval;
    z_rms : (p,) of each parameter alone"""

    sd: Array
    low: Array
    high: Array
    z_rms: Array


def agreement(basis: Basis) -> Agreement:
    """Of two or more."""
    value, covariance = basis.value, basis.covariance
    m, p = value.shape
    mean, own = _mean(value, covariance)
    z = np.zeros((m, p))
    for k in range(m):
        rest = np.arange(m) != k
        other, spread = _mean(value[rest], covariance[rest])
        z[k] = (value[k] - other) / np.sqrt(np.diag(covariance[k] + spread))
    inverse = np.linalg.pinv(covariance, hermitian=True)
    return Agreement(
        mean=mean,
        mean_sd=np.sqrt(np.diag(own)),
        z=z,
        chi2=float(np.einsum("ki,kij,kj->", value - mean, inverse, value - mean)),
        dof=(m - 1) * p,
        answer=difference_question(basis).answer(),
    )


def difference_question(basis: Basis) -> ChangeQuestion:
    """Which kinds of parameters differ in which file, all in units of their mean stated sd; of two
    files the last stands for both."""
    m, p = basis.value.shape
    sd = np.sqrt(np.einsum("kii->i", basis.covariance) / m)
    sd = np.where(sd > 0.0, sd, 1.0)
    shares = np.zeros_like(basis.covariance)
    if basis.power_ups is not None:
        shares = np.array(basis.power_ups.share)
    own = (basis.covariance - shares) / np.outer(sd, sd) + _LEAST * np.eye(p)
    alone = np.eye(m)[:, :, None] * np.eye(m)[:, None]  # of each file
    parts = [
        CovariancePart(np.kron(alone[k], own[k]), min(float(basis.dof[k]), KNOWN)) for k in range(m)
    ]
    if basis.power_ups is not None:
        whole = block_diag(*(share / np.outer(sd, sd) for share in shares))
        parts.append(CovariancePart(whole, min(basis.power_ups.dof, KNOWN)))
    unit = np.eye(m * p).reshape(m * p, m, p)
    kinds = dict.fromkeys(map(kind_of, basis.names))
    suspects = [
        Suspect(suspect(kind, k), (_SHOWN * unit[:, k, [kind_of(n) == kind for n in basis.names]],))
        for k in range(m == 2, m)
        for kind in kinds
    ]
    value = (basis.value / sd).ravel()
    return ChangeQuestion(value, tuple(parts), tuple(suspects), np.tile(np.eye(p), (m, 1)))


def kind_of(name: str) -> str:
    """What a parameter is one of: "bias" of "bias_x"."""
    return name.rpartition("_")[0] or name


def suspect(kind: str, file: int | str) -> str:
    """The name of what differs."""
    return f"{kind} of {file}"


def _is_of(file: int, name: str) -> bool:
    return name.endswith(suspect("", file))


def scatter(basis: Basis) -> ParameterScatter | None:
    """Parameter by parameter; None of fewer than three calibrations."""
    m = len(basis.value)
    if m < 3:
        return None
    variance = np.einsum("kii->ki", basis.covariance)
    pairs = list(zip(basis.value.T, variance.T, strict=True))
    found = [estimate_excess(value, own) for value, own in pairs]
    sd, low, high = (np.array([getattr(one, k) for one in found]) for k in ("sd", "low", "high"))
    squares = [fit_line(value, own, np.ones((m, 1)))[2] for value, own in pairs]
    return ParameterScatter(sd, low, high, np.sqrt(np.array(squares) / (m - 1)))


def _mean(value: Array, covariance: Array) -> tuple[Array, Array]:
    """Generalised least squares mean (..., p) of values (..., m, p) and its covariance (p, p)."""
    weight = np.linalg.pinv(covariance, hermitian=True)
    own = np.linalg.pinv(weight.sum(axis=0), hermitian=True)
    return np.einsum("kij,...kj->...i", weight, value) @ own, own
