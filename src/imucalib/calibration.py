"""A calibration: what is written to YAML, read back, and applied to readings.

Values in the file are in the units that the file names. The covariance covers all parameters in
their order. `matrices` are derived from the effects for those who only need a = M raw + b.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.context import Context
from imucalib.effects import catalogue
from imucalib.errors import UnreadableInput
from imucalib.fit import Fit
from imucalib.matrices import Matrices, matrices
from imucalib.model import Model
from imucalib.uncertainty import correcting
from imucalib.writers import replaced_atomically

Array = NDArray[np.float64]

SCHEMA = "imucal/calibration"
VERSION = 1
FORMULA = (
    "reading = x + sum of sensor effects(x), x = mounting turn of the specific force in the tool's "
    "frame; apply inverts it. Linear part: corrected = M raw + b, raw = S corrected + c (SI units)."
)


@dataclass(frozen=True)
class StoredParameter:
    """One parameter as stored: value and standard deviation in `unit`."""

    name: str
    effect: str
    stage: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True)
class Calibration:
    """A calibration apart from the data it came from.

    parameters : all, fixture included; covariance : (p, p) in their units and order
    raw_unit, raw_to_si : of the readings that it applies to
    facts : the blocks that only people read (gravity, conventions, noise, ranges, provenance)
    """

    calibrator: str
    parameters: tuple[StoredParameter, ...]
    covariance: Array
    raw_unit: str
    raw_to_si: float
    gravity: float
    status: str
    reasons: tuple[str, ...] = ()
    valid: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)

    def model(self) -> tuple[Model, Array]:
        """The correcting part as effects of the catalogue, with its θ.

        Raises UnreadableInput when the file names an effect that this version does not know.
        """
        names = dict.fromkeys(p.effect for p in self.parameters if p.stage != "fixture")
        unknown = [name for name in names if name not in catalogue()]
        if unknown:
            raise UnreadableInput(
                f"the calibration uses unknown effects: {', '.join(unknown)}",
                remedy="load the file that defines them with --effects, or update imucal",
            )
        model = Model(tuple(catalogue()[name] for name in names))
        by_effect = {n: [p.value for p in self.parameters if p.effect == n] for n in names}
        return model, np.array([v for e in model.effects for v in by_effect[e.name]])

    def apply(self, reading: Array, context: Context | None = None) -> Array:
        """Correct readings (n, 3) in m/s² to specific force (n, 3) in m/s² in the tool's frame.

        context : covariates that the effects need ("temperature"); raises UnreadableInput when
        one is missing, NotConverged when a reading lies outside the calibration's range
        """
        model, theta = self.model()
        known = context or Context(len(reading))
        for effect in model.effects:
            absent = [name for name in effect.needs if name not in known]
            if absent:
                raise UnreadableInput(
                    f"effect {effect.name} needs {', '.join(absent)}, which the recording lacks",
                    remedy="record it, or calibrate with --without " + effect.name,
                )
        return model.correct(theta, reading[:, None], known)[:, 0]

    def matrices(self) -> Matrices:
        """M, b and S, c of the linear part, with intrinsic scales and angles."""
        model, theta = self.model()
        keep = [k for k, p in enumerate(self.parameters) if p.stage != "fixture"]
        return matrices(model, theta, self.covariance[np.ix_(keep, keep)])


def from_fit(
    fit: Fit,
    calibrator: str,
    *,
    raw_unit: str,
    raw_to_si: float,
    gravity: float,
    status: str,
    reasons: tuple[str, ...],
    facts: Mapping[str, Any],
) -> Calibration:
    """The calibration of a fit; records that were set aside are no part of it."""
    context = fit.observations.context
    stored, keep = [], []
    for effect in fit.model.effects:
        part = fit.model.slices(context)[effect.name]
        if effect.name.startswith("record_error"):
            continue
        for k, parameter in zip(
            range(part.start, part.stop), effect.parameters(context), strict=True
        ):
            value, sd = float(fit.theta[k]), float(fit.sd[k])
            stored.append(
                StoredParameter(
                    parameter.name, effect.name, effect.stage, value, sd, parameter.unit
                )
            )
            keep.append(k)
    needed = {name for effect in correcting(fit.model).effects for name in effect.needs}
    valid = {
        name: (float(context[name].min()), float(context[name].max()))
        for name in sorted(needed | ({"temperature"} & set(context.covariates)))
    }
    return Calibration(
        calibrator, tuple(stored), fit.covariance[np.ix_(keep, keep)], raw_unit, raw_to_si, gravity,
        status, reasons, valid, facts,
    )  # fmt: skip


def to_yaml(calibration: Calibration) -> str:
    """The YAML text, version `VERSION` of the schema `SCHEMA`."""
    from imucalib.yaml_text import dump

    return dump(as_dict(calibration))


def as_dict(calibration: Calibration) -> dict[str, Any]:
    """The content of the YAML file as plain types."""
    linear = calibration.matrices()
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "calibrator": calibration.calibrator,
        "status": calibration.status,
        "reasons": list(calibration.reasons),
        "formula": FORMULA,
        "raw": {"unit": calibration.raw_unit, "to_m_per_s2": calibration.raw_to_si},
        "gravity_m_per_s2": calibration.gravity,
        "parameters": [
            {"name": p.name, "effect": p.effect, "stage": p.stage, "value": p.value, "sd": p.sd,
             "unit": p.unit}
            for p in calibration.parameters
        ],
        "covariance": calibration.covariance.tolist(),
        "matrices": linear.as_dict(),
        "valid": {name: list(span) for name, span in calibration.valid.items()},
        **calibration.facts,
    }  # fmt: skip


def write(calibration: Calibration, path: Path) -> None:
    """Write the YAML file whole or not at all."""
    write_whole(path, to_yaml(calibration))


def write_whole(path: Path, text: str) -> None:
    """Write a text file by a temporary neighbour and a rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read(path: Path) -> Calibration:
    """Read a calibration of any known version. Raises UnreadableInput with what is wrong where."""
    from ruamel.yaml import YAML, YAMLError

    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path))
    try:
        content = YAML(typ="safe", pure=True).load(StringIO(path.read_text(encoding="utf-8")))
    except (YAMLError, UnicodeDecodeError) as error:
        raise UnreadableInput(f"not a YAML file: {error}", where=str(path)) from None
    return from_dict(content, str(path))


def from_dict(content: Any, where: str) -> Calibration:
    """Build from the YAML's content; see `read`."""
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise UnreadableInput(
            "not a calibration of imucal",
            where=where,
            remedy=f"its first key must be schema: {SCHEMA}",
        )
    if content.get("version") != VERSION:
        raise UnreadableInput(
            f"schema version {content.get('version')} is not known",
            where=where,
            remedy="update imucal",
        )
    try:
        parameters = tuple(
            StoredParameter(
                str(p["name"]), str(p["effect"]), str(p["stage"]), float(p["value"]), float(p["sd"]),
                str(p["unit"]),
            )
            for p in content["parameters"]
        )  # fmt: skip
        covariance = np.array(content["covariance"], dtype=float).reshape(
            len(parameters), len(parameters)
        )
        known = {
            "schema", "version", "calibrator", "status", "reasons", "formula", "raw",
            "gravity_m_per_s2", "parameters", "covariance", "matrices", "valid",
        }  # fmt: skip
        return Calibration(
            str(content["calibrator"]),
            parameters,
            covariance,
            str(content["raw"]["unit"]),
            float(content["raw"]["to_m_per_s2"]),
            float(content["gravity_m_per_s2"]),
            str(content["status"]),
            tuple(content["reasons"]),
            {name: (float(a), float(b)) for name, (a, b) in content["valid"].items()},
            {name: block for name, block in content.items() if name not in known},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableInput(f"the calibration is incomplete: {error!r}", where=where) from None


def check(calibration: Calibration, where: str) -> None:
    """Raise UnreadableInput unless the content makes sense: a covariance, an invertible model."""
    covariance = calibration.covariance
    if not np.isfinite(covariance).all() or not np.allclose(covariance, covariance.T, rtol=1e-6):
        raise UnreadableInput("the covariance is not finite and symmetric", where=where)
    sd = np.array([p.sd for p in calibration.parameters])
    if not np.allclose(np.sqrt(np.maximum(np.diag(covariance), 0.0)), sd, rtol=1e-6, atol=1e-12):
        raise UnreadableInput("the standard deviations contradict the covariance", where=where)
    spread = np.linalg.eigvalsh(
        covariance / np.outer(np.maximum(sd, 1e-300), np.maximum(sd, 1e-300))
    )
    if spread.size and spread[0] < -1e-6:
        raise UnreadableInput("the covariance is not positive", where=where)
    model, theta = calibration.model()
    sensitivity = model.predict(theta, np.zeros((1, 1, 3)), Context(1, _zeros(model))).d_truth[0, 0]
    if abs(np.linalg.det(sensitivity)) < 1e-3:
        raise UnreadableInput("the calibration cannot be inverted", where=where)


def _zeros(model: Model) -> dict[str, Array]:
    return {name: np.zeros(1) for effect in model.effects for name in effect.needs}
