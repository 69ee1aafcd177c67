"""A recording of several chips on one board that was turned by hand, each with its own errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write
from worlds.flight_logs import dataflash, ulog
from worlds.turned_imu import G0, Chip, Log, chip, turned

NAMES = ("main", "aux")


def chips(count: int = 2) -> list[Chip]:
    return [chip(np.random.default_rng(40 + k)) for k in range(count)]


def logs(made: Sequence[Chip]) -> list[Log]:
    """What each reads in the same motion."""
    return [turned(one, np.random.default_rng(2)) for one in made]


def two_sensors(path: Path, names: Sequence[str] = NAMES) -> list[Chip]:
    """Write them by the path's suffix; the chips in the order of the names, which flight logs give
    themselves."""
    made = chips(len(names))
    found = logs(made)
    force, rate = (
        np.array(v) for v in ([G0 * log.force for log in found], [log.rate for log in found])
    )
    if path.suffix == ".csv":
        header = ["time (s)"]
        for name in names:
            header += [f"{name}_a{a} (m/s2)" for a in "xyz"] + [
                f"{name}_g{a} (rad/s)" for a in "xyz"
            ]
        rows = np.column_stack(
            [found[0].t, *(v for pair in zip(force, rate, strict=True) for v in pair)]
        )
        np.savetxt(path, rows, delimiter=",", header=",".join(header), comments="", fmt="%.9g")
    elif path.suffix in (".ulg", ".bin"):
        stamps = np.round(1e6 * found[0].t).astype(np.int64) + 1_000_000
        log = ulog if path.suffix == ".ulg" else dataflash
        path.write_bytes(log(stamps, force.astype(np.float32), rate.astype(np.float32)))
    else:
        write(_recording(found, names), path)
    return made


def _recording(found: Sequence[Log], names: Sequence[str]) -> Recording:
    channels = {}
    for name, log in zip(names, found, strict=True):
        for quantity, unit, t, values in (
            ("acceleration", "m/s2", log.t, G0 * log.force),
            ("angular_rate", "rad/s", log.t_gyro, log.rate),
        ):
            channels[f"{name}/{quantity}"] = Channel(t, values, unit, quantity, name, 100.0)
    return Recording(channels, "made", "made", "")
