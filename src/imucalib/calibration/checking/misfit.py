"""Misfits of a later recording, linearised once, with the parts of their covariance.

    misfit = reading - foretold = J (θ - θ̂) + N η + noise + C (change)

With the calibration's full covariance Cθ the misfits of an unchanged sensor have the covariance
V = s² W + J Cθ Jᵀ + Σ sd² N Nᵀ + Σ session² C Cᵀ. Each part's size was estimated with degrees of
freedom of its own; the calibration's covariance goes with the noise of its readings.

What a reading scatters by when a calibration is used, as its file states it, and how well that
is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.triads import Triad
from imucalib.core.balance import below
from imucalib.core.eigen import eigen
from imucalib.core.references import tangents
from imucalib.errors import UnreadableInput
from imucalib.units import DEG, MG


@dataclass(frozen=True)
class GyroRest:
    """A gyroscope at rest. bias : (3,) deg/s that it reads beyond its calibrated bias; sd : (3,)
    by the scatter between rests, the calibration's rests included; p : of no change, the smallest
    of its axes times three"""

    bias: Array
    sd: Array
    p: float


def triad_misfits(
    calibration: Calibration, triad: Triad, reading: Array, noise: CheckNoise, more: Array
) -> Misfits:
    """Misfits of one IMU. reading : (n, 3) m/s² in package axes, one a rest; more : (n,) (m/s²)²,
    variance of a rest beyond the array's usual one.

    reading = gain · force + bias in board axes; what its direction is, is not known.
    """
    n = len(reading)
    seen = reading @ triad.rotation.T
    force = np.linalg.solve(triad.gain, (seen - triad.bias).T).T
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    truth = calibration.gravity * direction
    across = triad.gain @ tangents(direction)
    keep = np.cross(across[..., 0], across[..., 1])
    keep = keep / np.linalg.norm(keep, axis=1, keepdims=True)
    slope = np.concatenate(
        [
            np.einsum("ij,nk->nijk", np.eye(3), truth).reshape(n, 3, 9),
            np.broadcast_to(np.eye(3), (n, 3, 3)),
        ],
        axis=2,
    )
    jacobian = np.einsum("ni,nip->np", keep, slope)
    bias = MG * keep
    return Misfits(
        value=np.einsum("ni,ni->n", keep, seen - truth @ triad.gain.T - triad.bias),
        reading=Part(np.diag(noise.reading.sd**2 + more), noise.reading.dof),
        setting={},
        session=noise.session,
        jacobian=jacobian,
        parameters=triad.covariance,
        changes={"bias": bias, "scale": 1e-3 * keep * truth},
        owner=np.arange(n, dtype=np.intp),
        label=tuple(f"rest {k + 1}" for k in range(n)),
        force=np.asarray(force, np.float64),
        directed=False,
    )


def gyro_rest(triad: Triad, rate: Array, rests: Mapping[str, float]) -> GyroRest | None:
    """rate : (n, 3) rad/s in package axes, one a rest; rests : of the calibration, its block.

    None where fewer than three rests have a rate: their scatter is the only noise that counts.
    """
    from scipy.special import stdtr

    known = rate[np.isfinite(rate).all(axis=1)]
    if len(known) < 3:
        return None
    moved = triad.rate(known) / DEG
    before = float(rests.get("count") or len(known))
    sd = moved.std(axis=0, ddof=1) * np.sqrt(1.0 / len(known) + 1.0 / before)
    sd = np.maximum(sd, 1e-12)
    each = 2.0 * stdtr(len(known) - 1, -np.abs(moved.mean(axis=0)) / sd)
    return GyroRest(moved.mean(axis=0), sd, float(min(1.0, 3.0 * each.min())))


#: Kinds of change, and the unit of their sizes.
FAMILIES: dict[str, str] = {"bias": "mg", "scale": "mg/g", "mounting": "deg"}
#: What a calibration of several sessions calls the errors that they share.
_CHANGES = {"session bias": "bias", "session mounting": "mounting"}
#: Degrees of freedom of a standard deviation that is taken at its word.
KNOWN = 1e6
#: Degrees of freedom that a setting's scatter has at least: below, its law has no mean, and one
#: component that hardly counts would hide every change.
_FEWEST = 4.0


@dataclass(frozen=True)
class Scatter:
    """One standard deviation (m/s² or rad) and the degrees of freedom behind it."""

    sd: float
    dof: float = KNOWN


@dataclass(frozen=True)
class Shared:
    """Noise of a bias that neighbouring readings share: share of a reading's variance, and the
    readings after which they forget."""

    share: float
    memory: float


@dataclass(frozen=True)
class CheckNoise:
    """reading : m/s², of one rest or position; setting : rad, by the name of the reference's
    component, of what was set; session : what one switching on brings, by the kind of change and
    in its unit; words : where each comes from; shared : of the readings' noise, or None
    """

    reading: Scatter
    setting: Mapping[str, Scatter]
    session: Mapping[str, Scatter]
    words: tuple[str, ...] = ()
    shared: Shared | None = None


def check_noise(
    calibration: Calibration,
    *,
    reading: float | None = None,
    session: Mapping[str, float] | None = None,
) -> CheckNoise:
    """The noise of a later recording.

    reading : m/s², instead of what the file states; session : by the kind of change and in its
    unit (bias mg, mounting deg), its scatter between power-ups instead of what the file states
    Raises UnreadableInput where neither tells the noise of a reading.
    """
    block = calibration.facts.get("noise") or {}
    words, shared = [], None
    if reading is not None:
        own = Scatter(reading)
        words.append(f"a reading scatters by {reading / MG:.3g} mg, as given")
    else:
        stated = _of_rests(calibration) or _stated(block, "reading", "mg", MG)
        if stated is None:
            raise UnreadableInput(
                "the calibration does not state the noise of a reading",
                remedy="give it: --noise 0.5mg, or calibrate again with this version",
            )
        own, shared = _with_shared(stated, block)
        words.append(
            f"a reading scatters by {own.sd / MG:.3g} mg, as in the calibration "
            + (f"({own.dof:.0f} degrees of freedom)" if own.dof < KNOWN else "(taken at its word)")
            + (f", of which neighbours share {100.0 * shared.share:.0f} %" if shared else "")
        )
    between, said = _session(calibration, session or {})
    names = ("inclination setting", "tool-face setting", "tilt")
    found = {name: _stated(block, _key(name), "deg", DEG) for name in names}
    setting = {name: _at_most(scatter) for name, scatter in found.items() if scatter is not None}
    return CheckNoise(own, setting, between, (*words, *said), shared)


def _with_shared(own: Scatter, block: Mapping[str, Any]) -> tuple[Scatter, Shared | None]:
    """A reading's noise with what its neighbours share, which can be all of it; degrees of freedom
    by Satterthwaite."""
    shared = _stated(block, "shared", "mg", MG)
    if shared is None or not shared.sd > 0.0:
        return own, None
    parts = np.array([own.sd**2, shared.sd**2])
    whole = float(parts.sum())
    dof = whole**2 / float(np.sum(parts**2 / np.array([own.dof, shared.dof])))
    memory = float(block["shared_memory_positions"])
    return Scatter(whole**0.5, dof), Shared(float(parts[1]) / whole, memory)


def _at_most(stated: Scatter) -> Scatter:
    """A setting's scatter with its own sd added: few settings may show none where there is some."""
    return Scatter(stated.sd * (1.0 + 0.5 / stated.dof) ** 0.5, max(stated.dof, _FEWEST))


def _of_rests(calibration: Calibration) -> Scatter | None:
    """Of an array's rests: n rests of K triads leave 3 K n - 2 n - 12 K degrees of freedom."""
    rests = calibration.facts.get("rests")
    if not calibration.triads or not isinstance(rests, Mapping):
        return None
    n, k = int(rests["count"]), len(calibration.triads)
    return Scatter(float(rests["residual_m_per_s2"]), max(3.0 * k * n - 2 * n - 12 * k, 1.0))


def _session(
    calibration: Calibration, given: Mapping[str, float]
) -> tuple[dict[str, Scatter], tuple[str, ...]]:
    """What a power-up brings: as given, as the file states it, or nothing."""
    if given:
        said = ", ".join(f"{size:.3g} {FAMILIES[name]} of {name}" for name, size in given.items())
        words = f"power-ups scatter by {said}, as given"
        return {name: Scatter(size) for name, size in given.items()}, (words,)
    found = stated_sessions(calibration)
    if found:
        said = ", ".join(f"{s.sd:.3g} {FAMILIES[name]} of {name}" for name, s in found.items())
        return found, (f"power-ups scatter by {said}, as in the calibration",)
    return {}, (
        "the scatter of biases between power-ups is not in it: the file states none "
        "(--between-sessions)",
    )


def stated_sessions(calibration: Calibration) -> dict[str, Scatter]:
    """What a power-up brings by the kind of change, of a calibration of several; empty of one."""
    stated = calibration.facts.get("between_sessions")
    if not isinstance(stated, Mapping):
        return {}
    # One size for three axes, from so many sessions.
    dof = 3.0 * (len(stated["sessions"]) - 1)
    return {
        _CHANGES[row["what"]]: Scatter(float(row["sd"]), dof)
        for row in stated["scatter"]
        if row["what"] in _CHANGES
    }


def _key(name: str) -> str:
    return name.replace(" ", "_").replace("-", "_")


def _stated(block: Mapping[str, Any], name: str, unit: str, si: float) -> Scatter | None:
    """A standard deviation of the noise block; its own sd tells its degrees of freedom,
    var(s) = s² / 2ν."""
    value = block.get(f"{name}_{unit}")
    if value is None:
        return None
    sd, spread = float(value) * si, float(block.get(f"{name}_sd_{unit}") or 0.0) * si
    return Scatter(sd, max(0.5 * (sd / spread) ** 2, 1.0) if spread > 0.0 and sd > 0.0 else KNOWN)


@dataclass(frozen=True)
class Part:
    """covariance : (N, N) (m/s²)²; dof : degrees of freedom behind its size"""

    covariance: Array
    dof: float

    def take(self, rows: Index) -> Part:
        return replace(self, covariance=self.covariance[np.ix_(rows, rows)])


@dataclass(frozen=True)
class Misfits:
    """N misfits of n rests or positions.

    value : (N,) m/s²; reading : of the readings' noise; setting : by the name of the component
    session : by the kind of change, what a power-up brings, in its unit
    jacobian : (N, p) by all of the calibration's parameters, zero for those that do not act here
    parameters : (p, p) their covariance; changes : per kind, (N, 3) m/s² per unit
    owner : (N,) row of each; label : (n,) of the rows; force : (n, 3) m/s² corrected
    directed : whether directions are known
    """

    value: Array
    reading: Part
    setting: Mapping[str, Part]
    session: Mapping[str, Scatter]
    jacobian: Array
    parameters: Array
    changes: Mapping[str, Array]
    owner: Index
    label: tuple[str, ...]
    force: Array
    directed: bool

    @property
    def n(self) -> int:
        return len(self.label)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Readings with the calibration's own error, settings, power-up."""
        carried = self.jacobian @ self.parameters @ self.jacobian.T
        columns = {k: s.sd * self.changes[k] for k, s in self.session.items() if k in self.changes}
        return (
            replace(self.reading, covariance=self.reading.covariance + carried),
            *self.setting.values(),
            *(Part(c @ c.T, self.session[kind].dof) for kind, c in columns.items()),
        )

    @cached_property
    def covariance(self) -> Array:
        """(N, N) of an unchanged sensor."""
        return np.asarray(np.sum([part.covariance for part in self.parts], axis=0))

    @cached_property
    def dof(self) -> float:
        """Of the whole covariance's scale: ν = 1 / Σ share² / ν_part (Satterthwaite 1946,
        Biometrics Bulletin 2, 110-114)."""
        inverse = np.linalg.inv(self.covariance)
        share = np.array([np.sum(inverse * part.covariance) for part in self.parts])
        share = share / share.sum()
        return float(1.0 / np.sum(share**2 / np.array([part.dof for part in self.parts])))

    def white(self, columns: Array) -> Array:
        """L⁻¹ columns, V = L Lᵀ."""
        return below(np.linalg.cholesky(self.covariance), columns)

    def drawn(self, rng: np.random.Generator, draws: int) -> Array:
        """(draws, N) whitened misfits of unchanged sensors, each part's true size drawn by what its
        estimate says: size² = estimate² ν / χ²(ν) (Fisher's fiducial law, exact of one part)."""
        total: Array = np.zeros((draws, self.value.size))
        for part in self.parts:
            white = self.white(self.white(part.covariance).T)
            values, vectors = eigen(0.5 * (white + white.T))
            keep = values > 1e-12 * max(float(values[-1]), 1e-300)
            # The symmetric root: equal values leave the vectors open, and rounding would choose.
            root = (vectors[:, keep] * np.sqrt(values[keep])) @ vectors[:, keep].T
            size = np.sqrt(part.dof / rng.chisquare(part.dof, draws))[:, None]
            total += size * (rng.standard_normal((draws, root.shape[1])) @ root.T)
        return total

    def take(self, rows: Index) -> Misfits:
        """Some of the rows, in order."""
        left = np.flatnonzero(np.isin(self.owner, rows))
        return replace(
            self,
            value=self.value[left],
            reading=self.reading.take(left),
            setting={name: part.take(left) for name, part in self.setting.items()},
            jacobian=self.jacobian[left],
            changes={name: c[left] for name, c in self.changes.items()},
            owner=np.searchsorted(rows, self.owner[left]),
            label=tuple(self.label[r] for r in rows),
            force=self.force[rows],
        )

    def without(self, row: int) -> Misfits:
        """All rows but one."""
        return self.take(np.delete(np.arange(self.n, dtype=np.intp), row))

    def joined(self, other: Misfits) -> Misfits:
        """Both, of one power-up: the calibration's errors and the session's are common to all."""
        m, k = self.value.size, other.value.size
        setting = {
            name: Part(
                _diagonal(_of(self.setting, name, m), _of(other.setting, name, k)),
                (self.setting.get(name) or other.setting[name]).dof,
            )
            for name in {**self.setting, **other.setting}
        }
        return replace(
            self,
            value=np.concatenate([self.value, other.value]),
            reading=Part(
                _diagonal(self.reading.covariance, other.reading.covariance), self.reading.dof
            ),
            setting=setting,
            jacobian=np.concatenate([self.jacobian, other.jacobian]),
            changes={n: np.concatenate([c, other.changes[n]]) for n, c in self.changes.items()},
            owner=np.concatenate([self.owner, other.owner + self.n]),
            label=(*self.label, *other.label),
            force=np.concatenate([self.force, other.force]),
        )


def _of(parts: Mapping[str, Part], name: str, size: int) -> Array:
    return parts[name].covariance if name in parts else np.zeros((size, size))


def _diagonal(one: Array, other: Array) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(one, other), np.float64)
