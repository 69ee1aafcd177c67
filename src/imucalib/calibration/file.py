"""Calibration files: YAML written, read back and checked.

The first line, a comment, is the SHA-256 of all lines below: a changed digit is no calibration.
Values in the file are in the units that the file names. The covariance covers all parameters in
their order. `matrices` are derived from the effects for those who only need a = M raw + b; an array
has `triads` in their place, one linear correction an IMU.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.atomic_file import replace_together
from imucalib.calibration.calibration import UNSETTLED, Calibration
from imucalib.calibration.triads import effect_covariance, triad_from
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.data import plain
from imucalib.errors import NotConverged, UnreadableInput
from imucalib.file_hash import sha256_of
from imucalib.recording.identity import NAMELESS, identity_from
from imucalib.recording.pairing import fault
from imucalib.recording.schema import misfits, schema_of
from imucalib.recording.yaml_text import content_of, dump, load

SCHEMA = "imucal/calibration"
VERSION = 3
FORMULA = (
    "reading = x + sum of sensor effects(x), x = mounting turn of the specific force in the tool's "
    "frame; apply inverts it. Linear part: corrected = M raw + b, raw = S corrected + c (SI units)."
)
ARRAY_FORMULA = (
    "In board axes (rotation applied): force = inv(gain) (reading - bias), rate = inv(gyro_gain) "
    "(reading - gyro_bias); force_k = s + (Ω(ω)² + Ω(dω/dt)) position_k. Found effects' linear "
    "parts are in the gains and biases; each effect adds what its equation says beyond."
)
_SUM = "# imucal calibration, sha256 of the lines below: "
#: What to do about a file that is no calibration.
_GIVE = "give the calibration.yaml that a calibrating command wrote, before any recording"
#: Keys that a file has; all others are facts for people.
_KEYS = (
    "schema version calibrator status reasons formula raw gravity_m_per_s2 parameters covariance "
    "matrices triads valid sensor"
)
#: Keys whose values are names, wherever they stand.
_NAMES = (
    "name imu triad effect effects stage unit calibrator status channel quantity names device "
    "serial"
)


def to_yaml(calibration: Calibration) -> str:
    """The YAML text, version `VERSION` of the schema `SCHEMA`, below the line with its sum."""
    text = dump(as_dict(calibration))
    return f"{_SUM}{_sum_of(text.encode(errors='backslashreplace'))}\n{text}"


def _sum_of(lines: bytes) -> str:
    """Hash of the text, whichever its line ends."""
    return hashlib.sha256(lines.replace(b"\r\n", b"\n")).hexdigest()


def as_dict(calibration: Calibration) -> dict[str, Any]:
    """The content of the YAML file as plain types."""
    triads = [triad.as_dict() for triad in calibration.triads]
    linear = {"triads": triads} if triads else {"matrices": calibration.matrices().as_dict()}
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "calibrator": calibration.calibrator,
        "status": calibration.status,
        "reasons": list(calibration.reasons),
        "sensor": (calibration.sensor or NAMELESS).as_dict(),
        "formula": ARRAY_FORMULA if triads else FORMULA,
        "raw": {"unit": calibration.raw_unit, "to_m_per_s2": calibration.raw_to_si},
        "gravity_m_per_s2": calibration.gravity,
        "parameters": [vars(p) for p in calibration.parameters],
        "covariance": calibration.covariance.tolist(),
        **linear,
        "valid": {name: list(span) for name, span in calibration.valid.items()},
        **plain(calibration.facts),
    }


def identity(calibration: Calibration) -> str:
    """SHA-256 of a calibration's file; one that was not read from a file is hashed as it would be
    written."""
    return calibration.sha256 or hashlib.sha256(to_yaml(calibration).encode()).hexdigest()


def write_whole(path: Path, text: str) -> None:
    """Write a text file by a temporary neighbour and a rename."""
    write_together({path: text})


def write_together(texts: Mapping[Path, str]) -> None:
    """Write several text files, all or none."""
    for path in texts:
        path.parent.mkdir(parents=True, exist_ok=True)
    with replace_together(tuple(texts)) as temporaries:
        for temporary, text in zip(temporaries, texts.values(), strict=True):
            temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def read(path: Path) -> Calibration:
    """Read a calibration of any known version. Raises UnreadableInput with what is wrong where, and
    NotConverged for one whose fit did not settle."""
    if path.is_dir():
        inside = path / "calibration.yaml"
        remedy = f"name {inside}" if inside.is_file() else "name the calibration's file"
        raise UnreadableInput("a folder, not a calibration", where=str(path), remedy=remedy)
    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path), remedy="check the path")
    first, _, lines = content_of(path, _GIVE).partition(b"\n")
    if first.startswith(_SUM.encode()) and first.strip().decode("latin-1") != _SUM + _sum_of(lines):
        raise UnreadableInput(
            "it was changed after it was written, by damage or by hand",
            where=str(path),
            remedy="restore it, or delete its first line if the change is meant",
        )
    found = from_dict(load(path, _GIVE), str(path))
    demand_settled(found, str(path))
    return replace(found, sha256=sha256_of(path))


def demand_settled(calibration: Calibration, where: str) -> None:
    """Raise NotConverged for the numbers of a fit that did not settle."""
    if UNSETTLED in calibration.reasons:
        remedy = "decide about what its report marks, and calibrate again"
        raise NotConverged(UNSETTLED, where=where, remedy=remedy)


def from_dict(content: Any, where: str) -> Calibration:
    """Build from the YAML's content; see `read`."""
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise UnreadableInput("not a calibration of imucal", where=where, remedy=_GIVE)
    if content.get("version") != VERSION:
        raise UnreadableInput(
            f"schema version {content.get('version')} is not known",
            where=where,
            remedy="calibrate again, or use the imucal that wrote it",
        )
    _check_names(content, where)
    if wrong := next(misfits(content, schema_of("calibration")), ""):
        raise UnreadableInput(f"the calibration is damaged: {wrong[:200]}", where=where)
    try:
        return _calibration(content)
    except ValueError as error:
        raise UnreadableInput(f"the calibration is damaged: {error}", where=where) from None


def _inside(block: Any, above: str = "") -> Iterator[tuple[str, str, Any]]:
    """Place, key and value of everything below a block."""
    if isinstance(block, list | tuple):
        block = dict(enumerate(block))
    for key, value in block.items() if isinstance(block, Mapping) else ():
        place = f"{above}.{key}" if above else str(key)
        yield place, str(key), value
        yield from _inside(value, place)


def _check_names(content: Mapping[str, Any], where: str) -> None:
    """Raise UnreadableInput for a name that could be taken for code where it is exported to."""
    keys = _NAMES.split()
    for place, key, value in _inside(content):
        values = (value if isinstance(value, list | tuple) else [value]) if key in keys else []
        for name in (key, *(v for v in values if isinstance(v, str))):
            if why := fault(name):
                raise UnreadableInput(
                    f"{place[:80]!a} is no name: {why}",
                    where=where,
                    remedy="rename it in the file: letters, digits, blanks and _ - . : / will do",
                )


def _calibration(content: dict[str, Any]) -> Calibration:
    parameters = tuple(parameter_from(block) for block in content["parameters"])
    for block in content.get("effects", ()):
        effect_covariance(block)
    size = len(parameters)
    covariance = np.array(content["covariance"], dtype=float).reshape(size, size)
    return Calibration(
        calibrator=str(content["calibrator"]),
        parameters=parameters,
        covariance=covariance,
        raw_unit=str(content["raw"]["unit"]),
        raw_to_si=float(content["raw"]["to_m_per_s2"]),
        gravity=float(content["gravity_m_per_s2"]),
        status=str(content["status"]),
        reasons=tuple(content["reasons"]),
        valid={name: (float(a), float(b)) for name, (a, b) in content["valid"].items()},
        facts={name: block for name, block in content.items() if name not in _KEYS.split()},
        triads=tuple(triad_from(block) for block in content.get("triads", ())),
        sensor=identity_from(content["sensor"]),
    )


def parameter_from(block: Mapping[str, Any]) -> StoredParameter:
    """A parameter from its block; raises KeyError, TypeError or ValueError where it is damaged."""
    name, effect, stage, unit = (str(block[key]) for key in ("name", "effect", "stage", "unit"))
    return StoredParameter(name, effect, stage, float(block["value"]), float(block["sd"]), unit)


def check(calibration: Calibration, where: str) -> None:
    """Raise UnreadableInput unless the content makes sense: a covariance, an invertible model."""
    for covariance in (calibration.covariance, *(t.covariance for t in calibration.triads)):
        if not np.isfinite(covariance).all() or not np.allclose(
            covariance, covariance.T, rtol=1e-6
        ):
            raise UnreadableInput("the covariance is not finite and symmetric", where=where)
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(sd > 0.0, sd, 1.0)
        if np.linalg.eigvalsh(covariance / np.outer(size, size)).min(initial=0.0) < -1e-6:
            raise UnreadableInput("the covariance is not positive", where=where)
    own = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    if not np.allclose(own, [p.sd for p in calibration.parameters], rtol=1e-6, atol=1e-12):
        raise UnreadableInput("the standard deviations contradict the covariance", where=where)
    model, theta = calibration.model()
    gains = [g for triad in calibration.triads for g in (triad.gain, triad.gyro_gain)]
    zeros = {name: np.zeros(1) for effect in model.effects for name in effect.needs}
    gains += [model.predict(theta, np.zeros((1, 1, 3)), Context(1, zeros)).d_truth[0, 0]]
    if min(abs(np.linalg.det(gain)) for gain in gains) < 1e-3:
        raise UnreadableInput("the calibration cannot be inverted", where=where)
