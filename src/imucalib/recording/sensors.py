"""Which sensor of a recording is meant: the one that is named, or the only one there is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from imucalib.errors import UsageError
from imucalib.recording.pairing import list_names
from imucalib.recording.recording import Channel, Recording

#: The name that stands for every sensor, each by itself.
ALL = "all"


def accelerometers(recording: Recording) -> dict[str, Channel]:
    """The accelerometers of a recording, or of a block of it, by the names of their sensors."""
    return {c.triad: c for c in recording.channels.values() if c.quantity == "acceleration"}


def accelerometer(recording: Recording, sensor: str = "") -> Channel:
    """The accelerometer of the sensor that is named (a topic or frame_id does too), or the only
    one. Raises UsageError, with the names, where that is none or several."""
    found = _named(accelerometers(recording), sensor)
    if len(found) != 1:
        raise undecided(accelerometers(recording), sensor, recording.path)
    return next(iter(found.values()))


def angular_rate(recording: Recording, sensor: str) -> Channel | None:
    """The rate of a sensor; one that no accelerometer shares a name with is of the only one. None
    where there is none. Raises UsageError where it may be one of several."""
    found = [c for c in recording.channels.values() if c.quantity == "angular_rate"]
    others = accelerometers(recording).keys() - {sensor}
    own = [c for c in found if c.triad == sensor] or [c for c in found if c.triad not in others]
    if len(own) > 1:
        names = list_names([c.triad for c in own])
        raise UsageError(
            f"{len(own)} gyroscopes, and none is called {sensor}: {names}",
            where=recording.path,
            remedy="name the fields of its own with --gyro",
        )
    return own[0] if own else None


def select_sensor(blocks: Iterable[Recording], sensor: str) -> Iterator[Recording]:
    """The blocks of a recording without what belongs to other accelerometers. Raises UsageError
    where no accelerometer of any block, or more than one, has the name."""
    known: dict[str, Channel] = {}
    path, chosen = "", ""
    for block in blocks:
        path = block.path
        known |= accelerometers(block)
        found = _named(known, sensor)
        if len(found) > 1 or (found and chosen not in ("", *found)):
            raise undecided(known, sensor, path)
        chosen = next(iter(found), "")
        own = {n: c for n, c in block.channels.items() if c.triad not in known.keys() - {chosen}}
        yield replace(block, channels=own, mapping={**block.mapping, "sensor": sensor})
    if not chosen:
        raise undecided(known, sensor, path)


def _named(found: dict[str, Channel], sensor: str) -> dict[str, Channel]:
    """Those that are called so: by the name of the recording, else by one of the file's."""
    if not sensor or sensor in found:
        return found if not sensor else {sensor: found[sensor]}
    return {name: c for name, c in found.items() if sensor in c.names}


def undecided(found: Iterable[str], sensor: str, path: str) -> UsageError:
    """That it is not clear which of the sensors `found` is meant by a name, or by none."""
    names = list(found)
    if not names:
        return UsageError(
            "the recording has no acceleration channel",
            where=path,
            remedy="`imucal inspect FILE` lists what it has; name the columns with --acc X,Y,Z",
        )
    what = f"{len(names)} sensors to choose from" if not sensor else f"no sensor '{sensor}' in it"
    return UsageError(
        f"{what}: {list_names(names)}",
        where=path,
        remedy="name one with --sensor (`imu` takes --sensor all: a calibration each)",
        add=("--sensor", names[0]),
    )
