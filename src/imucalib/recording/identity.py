"""Which sensor of which device it is, as its recording says: carried to all that is made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any

from imucalib.arrays import Array
from imucalib.data import Data
from imucalib.errors import UsageError
from imucalib.recording.onboard import Onboard, onboard_from
from imucalib.recording.pairing import fault
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.sensors import accelerometer, accelerometers


class Identity(Data, sparse=True):
    """Which sensor of which device it is, as the recording says; what it does not say is absent.

    name : empty where the reader only numbered it; names : in full, then its frame_id
    topic : of messages, which it came in; device, serial : what holds it, and its number
    to_m_per_s2, zero, step : (1,) or one an axis
    onboard, onboard_rate : what a flight controller did to its readings, and to the gyroscope's
    """

    name: Annotated[str, "In the recording."] = ""
    names: Annotated[tuple[str, ...], "Topic or dataset, frame_id."] = ()
    topic: str = ""
    device: str = ""
    serial: str = ""
    unit: Annotated[str, "Of the readings in the file."] = ""
    to_m_per_s2: tuple[float, ...] = ()
    zero: Annotated[tuple[float, ...], "Taken off readings in the unit before."] = ()
    step: Annotated[tuple[float, ...], "Smallest step between readings, m/s2."] = ()
    rate_hz: float = 0.0
    onboard: Onboard | None = None
    onboard_rate: Onboard | None = None

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
        k: tuple(v) if isinstance(v, list) else onboard_from(v) if isinstance(v, dict) else v
        for k, v in block.items()
        if k in known
    }
    return Identity(**found)


def identity_of(recording: Recording, sensor: str, step: Array | None = None) -> Identity:
    """The identity of a sensor of a recording. step : (3,) m/s², 0 where it is not known"""
    channel = accelerometers(recording)[sensor]
    rates = [c for c in recording.channels.values() if c.quantity == "angular_rate"]
    names = [name for name in channel.names if not fault(name)]
    known = step is not None and step.all()
    return Identity(
        name="" if channel.numbered or fault(sensor) else sensor,
        names=tuple(names),
        topic=channel.topic,
        device=recording.device,
        serial=recording.serial,
        unit=channel.raw_unit,
        to_m_per_s2=channel.raw_to_si,
        zero=channel.raw_zero,
        step=tuple(step.tolist()) if step is not None and known else (),
        rate_hz=channel.rate,
        onboard=channel.onboard,
        onboard_rate=next((c.onboard for c in rates if c.triad == sensor), None),
    )


def accelerometer_of(wanted: Identity | None, recording: Recording, sensor: str = "") -> Channel:
    """The accelerometer of a recording that a calibration is of: the one that is named, or the one
    of its name, or the only one. wanted : whose calibration it is, None for whichever

    Raises UsageError, with both names, for another sensor or device, and where it may be several.
    """
    found = accelerometers(recording)
    names = _names(wanted) if wanted else set[str]()
    alike = [name for name in found if names & _names(identity_of(recording, name))]
    chosen = accelerometer(recording, sensor or (alike[0] if len(alike) == 1 else ""))
    if wanted is not None:
        own = identity_of(recording, chosen.triad)
        demand_device(wanted, recording)
        if names and _names(own) and not names & _names(own):
            raise _another(wanted, own, recording.path)
        if not same_parameters(wanted, own):  # as once the controller has the calibration
            raise UsageError(
                "the controller's parameters are others than in the log that was calibrated: the "
                "correction would be made twice, or half",
                where=recording.path,
                remedy="calibrate this log by itself; if its readings are those, insist",
                add=("--same-device",),
            )
    return chosen


def same_parameters(one: Identity, other: Identity) -> bool:
    """Whether a controller had corrected the readings of both alike."""
    before, now = ((of.onboard or Onboard()) for of in (one, other))
    return (before.offset, before.scale) == (now.offset, now.scale)


def demand_device(wanted: Identity | None, recording: Recording) -> None:
    """Raise UsageError where a recording is of another device than a calibration."""
    own = Identity(device=recording.device, serial=recording.serial)
    if wanted and wanted.serial and own.serial and wanted.serial != own.serial:
        raise _another(wanted, own, recording.path)


def says_which(wanted: Identity | None, recording: Recording, sensor: str) -> bool:
    """Whether names or numbers say that a sensor is the one of a calibration, or the user does."""
    own = identity_of(recording, sensor)
    return wanted is None or bool(_names(wanted) & _names(own) or (wanted.serial and own.serial))


def _names(identity: Identity) -> set[str]:
    return {identity.name, *identity.names} - {""}


def _another(wanted: Identity, own: Identity, path: str) -> UsageError:
    return UsageError(
        f"the calibration is of {wanted}, the recording of {own}",
        where=path,
        remedy="give the calibration of this sensor; if it is the same, insist",
        add=("--same-device",),
    )
