"""Evidence against "nothing has changed" that stays valid however often one looks.

Over checks 1 … t of one calibration the misfits are stacked; its own error is common to all. A
change of a family that began with check τ adds κ² s² C Cᵀ to their covariance. Given the noise
estimate (ν degrees of freedom) both laws are multivariate t, whose ratio

    E = (|V₀| / |V₁|)^½ ((ν + eᵀV₀⁻¹e) / (ν + eᵀV₁⁻¹e))^((ν+N)/2)

is a test martingale for what is free of the scale: its mean is 1 at any stopping time (Pérez-Ortiz,
Lardy, de Heide and Grünwald 2024, Annals of Statistics 52, 1410-1432). `mixture` is its mean over
families, sizes κ and beginnings τ, weighted 1/(τ(τ+1)); what begins later counts 1.

At one look a fixed level has more power, so most of the stake goes on it: look j pays w_j / α_j
when its p is at most α_j = 0.7 α w_j, w = 0.7 for the first look and 0.3 / (j (j-1)) for others:
each payment has a mean of at most w_j, and sums need no independence (Vovk and Wang 2021, Annals of
Statistics 49, 1736-1754). By Ville's and Markov's inequalities E = 0.3 mixture + 0.7 payments ever
reaches 1/α with a chance of at most α.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.atomic_file import replaced_atomically
from imucalib.calibration.checking.misfit import FAMILIES
from imucalib.calibration.plain import plain
from imucalib.errors import UnreadableInput, UsageError
from imucalib.units import DEG, MG

SCHEMA = "imucal/check-history/1"


@dataclass(frozen=True)
class PastCheck:
    """One line. sensors : name -> what its evidence needs; told : all else, as it was written"""

    sensors: Mapping[str, Look]
    told: Mapping[str, Any]


def read_history(path: Path, sha256: str) -> tuple[PastCheck, ...]:
    """Past checks of the calibration whose file has this sum; none where there is no file.

    Raises UnreadableInput for a damaged line, UsageError for a history of another calibration.
    """
    if not path.exists():
        return ()
    found = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        where = f"{path}, line {number}"
        try:
            content = json.loads(line)
            if content["schema"] != SCHEMA:
                raise ValueError(content["schema"])
            of = content["calibration_sha256"]
            sensors = {name: _look(block) for name, block in content["sensors"].items()}
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise UnreadableInput(
                f"no line of a history of checks: {error!r}",
                where=where,
                remedy="restore it, or begin another history",
            ) from None
        if of != sha256:
            raise UsageError(
                "this history is of another calibration",
                where=where,
                remedy="every calibration has a history of its own: name another file",
            )
        found.append(PastCheck(sensors, content))
    return tuple(found)


def counted_once(past: Sequence[Look], now: Array) -> tuple[Look, ...]:
    """Past looks whose readings are in no later one, nor in `now` (N,) m/s²: a log that is checked
    again, or goes on where it ended, tells nothing twice."""
    later, kept = [now], list[Look]()
    for look in reversed(past):
        if not any(np.isin(look.value, value).all() for value in later):
            kept.append(look)
        later.append(look.value)
    return tuple(reversed(kept))


def append_check(path: Path, past: Sequence[PastCheck], now: PastCheck) -> None:
    """Write the history with one more line, whole or not at all."""
    lines = [json.dumps(one.told) for one in past]
    told = {**now.told, "sensors": {name: _block(look) for name, look in now.sensors.items()}}
    lines.append(json.dumps(plain({"schema": SCHEMA, **told}), allow_nan=False))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_atomically(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _block(look: Look) -> dict[str, Any]:
    return {
        "p": look.p,
        "misfit_m_per_s2": look.value,
        "noise_covariance": look.noise,
        "jacobian": look.jacobian,
        "changes": dict(look.changes),
    }


def _look(block: Mapping[str, Any]) -> Look:
    def array(value: Any, dimensions: int) -> Array:
        found = np.array(value, dtype=float)
        if found.ndim != dimensions or not np.isfinite(found).all():
            raise ValueError("not the numbers of a check")
        return found

    return Look(
        value=array(block["misfit_m_per_s2"], 1),
        noise=array(block["noise_covariance"], 2),
        jacobian=array(block["jacobian"], 2),
        changes={str(name): array(value, 2) for name, value in block["changes"].items()},
        p=float(block["p"]),
    )


#: Sizes of a change, in noise of one reading, that the mixture holds.
KAPPA = (1.0, 2.0, 4.0, 8.0)
ALPHA = 0.05
#: Share of the stake on single looks, and of that on the first.
ON_LOOKS, ON_FIRST = 0.7, 0.7


@dataclass(frozen=True)
class Look:
    """One check, as its history keeps it.

    value : (N,) m/s²; noise : (N, N); jacobian : (N, p); changes : per family (N, 3), m/s² per unit
    p : of the check by itself
    """

    value: Array
    noise: Array
    jacobian: Array
    changes: Mapping[str, Array]
    p: float


def e_value(
    looks: Sequence[Look], parameters: Array, *, reading: float, dof: float, gravity: float
) -> float:
    """E after the last look. parameters : (p, p) covariance; reading : m/s², s; dof : ν"""
    mixed = mixture(looks, parameters, reading=reading, dof=dof, gravity=gravity)
    return (1.0 - ON_LOOKS) * mixed + ON_LOOKS * paid([look.p for look in looks])


def paid(p: Sequence[float], alpha: float = ALPHA) -> float:
    """What the looks at a fixed level have paid, each 1 / (0.7 α) where it reached its level."""
    j = np.arange(1, len(p) + 1)
    weight = np.where(j == 1, ON_FIRST, (1.0 - ON_FIRST) / np.maximum(j * (j - 1), 1))
    return float(np.sum(np.asarray(p) <= ON_LOOKS * alpha * weight)) / (ON_LOOKS * alpha)


def mixture(
    looks: Sequence[Look], parameters: Array, *, reading: float, dof: float, gravity: float
) -> float:
    """The martingale alone."""
    from scipy.linalg import solve_triangular

    value = np.concatenate([look.value for look in looks])
    jacobian = np.concatenate([look.jacobian for look in looks])
    plain = _block_diagonal([look.noise for look in looks]) + jacobian @ parameters @ jacobian.T
    root = np.linalg.cholesky(plain)
    white = solve_triangular(root, value, lower=True)
    number = np.repeat(np.arange(len(looks)), [look.value.size for look in looks])
    unit = {"bias": reading, "scale": reading / gravity, "mounting": reading / gravity}
    names = [name for name in FAMILIES if all(name in look.changes for look in looks)]
    total = 1.0 / (len(looks) + 1)  # changes that have not begun yet
    for start in range(len(looks)):
        weight = 1.0 / ((start + 1) * (start + 2))
        for name in names:
            columns = np.concatenate([look.changes[name] for look in looks])
            scaled = columns * unit[name] / _si(name) * (number >= start)[:, None]
            ready = solve_triangular(root, scaled, lower=True)
            logs = [_log_ratio(white, ready, k, dof) for k in KAPPA]
            total += weight * float(np.mean(np.exp(np.minimum(logs, 500.0)))) / len(names)
    return total


def _si(name: str) -> float:
    """m/s², 1 or rad of a family's unit."""
    return {"bias": MG, "scale": 1e-3, "mounting": DEG}[name]


def _log_ratio(white: Array, columns: Array, kappa: float, dof: float) -> float:
    """log E of one change: V₁ = V₀ + κ² C Cᵀ, in coordinates where V₀ is 1."""
    vectors, values, _ = np.linalg.svd(kappa * columns, full_matrices=False)
    power, n = float(white @ white), white.size
    explained = float(np.sum((vectors.T @ white) ** 2 * values**2 / (1.0 + values**2)))
    logs = np.log1p(power / dof) - np.log1p((power - explained) / dof)
    return float(0.5 * (dof + n) * logs - 0.5 * np.sum(np.log1p(values**2)))


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*blocks), np.float64)
