"""The checks of one calibration, a JSON line each, as evidence needs them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.atomic_file import replaced_atomically
from imucalib.calibration.checking.e_value import Look
from imucalib.calibration.plain import plain
from imucalib.errors import UnreadableInput, UsageError

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
