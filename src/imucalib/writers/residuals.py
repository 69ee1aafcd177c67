"""A corrected recording with its rests as MCAP, for Foxglove, PlotJuggler and Rerun."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from imucalib.atomic_file import replace_atomically
from imucalib.errors import UsageError
from imucalib.recording.recording import REST, Recording
from imucalib.writers import write


def residual_files(path: Path) -> tuple[Path, Path]:
    """What `write_residuals` writes for a path; UsageError for another suffix than ".mcap"."""
    if path.suffix != ".mcap":
        raise UsageError(
            "residuals are written as MCAP",
            where=str(path),
            remedy=f"name it {path.with_suffix('.mcap')}, which Rerun and PlotJuggler open too",
        )
    return path, path.with_suffix(".foxglove.json")


def write_residuals(recording: Recording, path: Path) -> None:
    """Write corrected sensors and their rests, as `calibration.apply` makes them: topics
    "/<triad>/imu" (sensor_msgs/Imu) and "/<triad>/rest", and beside the file a layout for Foxglove.

    Raises UsageError as `residual_files` and `writers.write`.
    """
    log, layout = residual_files(path)
    write(recording, log)
    with replace_atomically(layout) as temporary:
        temporary.write_text(json.dumps(_layout(recording), indent=2) + "\n", encoding="utf-8")


def _layout(recording: Recording) -> dict[str, Any]:
    """A layout of Foxglove, as its app exports them: residuals of all sensors above, their rests'
    duration below, both at the times of the messages."""
    triads = [c.triad for c in recording.channels.values() if c.quantity == REST]
    panels = {
        "Plot!residuals": ("|a| - g at rest, mg", ("residual_before", "residual_after")),
        "Plot!duration": ("rest, s", ("duration",)),
    }
    plots = {
        name: {
            "title": title,
            "xAxisVal": "timestamp",
            "isSynced": True,
            "showLegend": True,
            "legendDisplay": "floating",
            "paths": [
                {
                    "value": f"/{triad}/{REST}.{field}",
                    "label": f"{triad} {field}".replace("_", " "),
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                }
                for triad in triads
                for field in fields
            ],
        }
        for name, (title, fields) in panels.items()
    }
    first, second = plots
    return {
        "configById": plots,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "column", "first": first, "second": second, "splitPercentage": 75},
    }
