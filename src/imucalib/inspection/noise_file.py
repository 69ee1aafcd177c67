"""Noise of sensors at rest as Kalibr's imu.yaml has it, for Kalibr and for exports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imucalib.atomic_file import replaced_atomically
from imucalib.errors import UnreadableInput
from imucalib.inspection.noise import Coefficient, SensorNoise
from imucalib.recording.yaml_text import dump, load

_PREFIX = {"acceleration": "accelerometer", "angular_rate": "gyroscope"}


def noise_blocks(noise: Sequence[SensorNoise]) -> dict[str, dict[str, Any]]:
    """By triad: densities in unit/√Hz and random walks in unit/s/√Hz (SI), each of the noisiest
    axis. A walk that the recording does not show on any axis is absent."""
    blocks: dict[str, dict[str, Any]] = {}
    for sensor in noise:
        block = blocks.setdefault(sensor.triad, {})
        prefix = _PREFIX[sensor.quantity]
        for name, term in (("noise_density", "white"), ("random_walk", "walk")):
            shown = [_value(getattr(axis, term)) for axis in sensor.axes]
            if known := [value for value in shown if value is not None]:
                block[f"{prefix}_{name}"] = max(known)
        block["rostopic"] = f"/{sensor.triad}/imu"
        block["update_rate"] = sensor.rate
    return blocks


def _value(found: Coefficient) -> float | None:
    return found.value


def save_noise(noise: Sequence[SensorNoise], source: str, path: Path) -> None:
    """Write the blocks. One sensor's keys stand alone, as Kalibr reads them; more by name."""
    blocks = noise_blocks(noise)
    lines = [
        f"# Noise at rest of {source}, SI: m/s2/sqrt(Hz), m/s3/sqrt(Hz), rad/s/sqrt(Hz), "
        "rad/s2/sqrt(Hz); of each sensor's noisiest axis.",
        *(
            f"# {name}: not shown, the rests are too short: {', '.join(lost)}"
            for name, block in blocks.items()
            if (lost := missing(block))
        ),
    ]
    content = next(iter(blocks.values())) if len(blocks) == 1 else blocks
    text = "\n".join([*lines, dump(content)])
    with replaced_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def missing(block: Mapping[str, Any]) -> list[str]:
    """Keys that Kalibr asks for and the block lacks."""
    names = ("noise_density", "random_walk")
    return [key for p in _PREFIX.values() for n in names if (key := f"{p}_{n}") not in block]


def read_noise(path: Path) -> dict[str, dict[str, Any]]:
    """Blocks by triad; one that stands alone is under "". Raises UnreadableInput for another
    file."""
    content = load(path)
    if isinstance(content, dict) and content:
        if "update_rate" in content:
            return {"": dict(content)}
        if all(isinstance(v, dict) and "update_rate" in v for v in content.values()):
            return {str(k): dict(v) for k, v in content.items()}
    raise UnreadableInput(
        "no noise of sensors",
        where=str(path),
        remedy="write it with `imucal inspect FILE --save-noise FILE`",
    )
