"""Gulf Coast Data Concepts: CSV in counts (X16, X2) or in units that the header states (HAM, MRL),
seconds since the start in the header or in the rows."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from imucalib.readers.devices.catalogue import Device, Start
from imucalib.recording.mapping import FieldMapping
from imucalib.units import canonical

_START = re.compile(r"start_time\s*,\s*(\d{4}-\d{2}-\d{2})\s*,\s*(\d{2}:\d{2}:\d{2})(\.\d+)?", re.I)


#: The line of the sensor's chip, or one a quantity with counts in one of its unit.
_UNITS = re.compile(r"units, (mg|g), (mdps|dps)", re.I)
_SENSITIVITY = re.compile(r";(accel|gyro), *[\d.]+, *(1|1000), *[\d.]+, *(g|dps)\b", re.I)


def _units(text: str) -> dict[str, str]:
    chip = _UNITS.search(text)
    if chip:
        return {"acceleration": canonical(chip[1]), "angular_rate": canonical(chip[2])}
    return {
        "acceleration" if kind.lower() == "accel" else "angular_rate": canonical(
            f"m{unit}" if counts == "1000" else unit
        )
        for kind, counts, unit in _SENSITIVITY.findall(text)
    }


def _start(text: str) -> Start:
    found, units = _START.search(text), _units(text)
    try:
        whole = datetime.fromisoformat(f"{found[1]}T{found[2]}") if found else None
    except ValueError:
        whole = None
    if found is None or whole is None:
        return Start(units=units)
    seconds = int(whole.replace(tzinfo=UTC).timestamp())
    part = round(float(found[3] or 0) * 1e9)
    notes = ("the start time has no zone: taken as UTC",)
    return Start(seconds * 1_000_000_000 + part, notes, units=units)


_EXAMPLE = """;Title, http://www.gcdataconcepts.com, LSM6DSM, BMP384, GPS
;Version, 2476, Build date, Apr 17 2023,  SN:CCDC20235263491
;Start_time, 2023-05-31, 22:09:12.819
;Uptime, 5,sec,  Vbat, 4194, mv, EOL, 3500, mv
;Deadband, 0, counts
;DeadbandTimeout, 5.000,sec
;LSM6DSM, SR,104,Hz, Units, mG, mdps, fullscale gyro 250dps, accel 4g
;Magnetometer, SR,10,Hz, Units, nT, Temperature, 37,degC
;BMP384, SI, 0.100,sec, Units, Pa, mdegC
;Alt Trigger disabled
;CAM_M8 Gps, SR,1,Hz
;Gps Sats, TOW, 0, ver, 0, numSat, 0
;, gnssId, svId, cno, elev, azmith, prRes, flags,inUse
;Time, Ax, Ay, Az, Gx, Gy, Gz, Mx, My, Mz, P, T
1685570953.732178,18,-12,1012,-866,-2328,-132,52734,3735,2868,101368,39951
1685570953.741470,17,-12,1015,-813,-2442,-167
1685570953.750762,17,-13,1016,-866,-2363,-184
1685570953.760054,17,-12,1014,-857,-2450,-202
1685570953.769346,18,-13,1014,-857,-2415,-245
1685570953.778638,18,-12,1014,-840,-2407,-219
1685570953.787930,18,-12,1014,-813,-2450,-219
1685570953.797222,17,-11,1014,-831,-2459,-167
"""

DEVICE = Device(
    "gcdc",
    FieldMapping(time="1", acc=("2", "3", "4"), time_unit="s"),
    words=("gcdataconcepts",),
    start=_start,
    scales=(1024.0, 2048.0, 16384.0),  # by model and gain; the header names neither,
    example=_EXAMPLE,
    source="README of the AerobaticLogger project on GitHub (an IMU-GPS logger)",
)
