"""Which sensor of which device it is, as its recording says: carried to all that is made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from imucalib.arrays import Array
from imucalib.recording.pairing import fault
from imucalib.recording.recording import Recording
from imucalib.recording.sensors import accelerometers


@dataclass(frozen=True)
class Identity:
    """A sensor; what the recording does not say is empty.

    name : in the recording, empty where the reader only numbered it
    names : what else the file calls it, in full: topic or dataset, then its frame_id
    device, serial : kind of the device that holds it, and its number
    unit : of the readings in the file; to_m_per_s2 : one of it, (1,) or one an axis
    step : smallest step between readings, m/s², an axis; rate_hz : samples a second
    """

    name: str = ""
    names: tuple[str, ...] = ()
    device: str = ""
    serial: str = ""
    unit: str = ""
    to_m_per_s2: tuple[float, ...] = ()
    step: tuple[float, ...] = ()
    rate_hz: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """The block of calibration.yaml and report.json: what is known."""
        known = {name: value for name, value in vars(self).items() if value}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in known.items()}

    def __str__(self) -> str:
        """In words: "aux (/aux/imu), AX3 12345"; "a sensor without a name" where none is known."""
        called = self.name or next(iter(self.names), "")
        also = [name for name in self.names if name != called]
        words = f"{called} ({', '.join(also)})" if also else called
        device = f"{self.device} {self.serial}".strip()
        return ", ".join(filter(None, (words, device))) or "a sensor without a name"


#: Of what says nothing of its sensor.
NAMELESS = Identity()


def identity_from(block: Mapping[str, Any]) -> Identity:
    """The identity of its block, which has the right types."""
    known = {one.name for one in fields(Identity)}
    found: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in block.items() if k in known
    }
    return Identity(**found)


def identity_of(recording: Recording, sensor: str, step: Array | None = None) -> Identity:
    """The identity of a sensor of a recording. step : (3,) m/s², 0 where it is not known"""
    channel = accelerometers(recording)[sensor]
    names = [name for name in channel.names if not fault(name)]
    known = step is not None and step.all()
    return Identity(
        name="" if channel.numbered or fault(sensor) else sensor,
        names=tuple(names),
        device=recording.device,
        serial=recording.serial,
        unit=channel.raw_unit,
        to_m_per_s2=channel.raw_to_si,
        step=tuple(step.tolist()) if step is not None and known else (),
        rate_hz=channel.rate,
    )
