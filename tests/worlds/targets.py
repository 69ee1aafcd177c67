"""What other programs load an export with: their own reader, or their source's rules once more."""

from __future__ import annotations

import csv
import json
import subprocess
from io import StringIO
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from imucalib.arrays import Array

_NOISE = ("noise_density", "random_walk")


def by_kalibr(text: str) -> dict[str, Any]:
    """As ethz-asl/kalibr, kalibr_common/ConfigReader.py, ImuParameters asks of an imu.yaml."""
    data = dict(YAML(typ="safe", pure=True).load(text))
    assert isinstance(data["rostopic"], str)
    assert data["update_rate"] > 0.0
    for key in (f"{sensor}_{n}" for sensor in ("accelerometer", "gyroscope") for n in _NOISE):
        assert data[key] > 0.0, key
    return data


def by_ggir(text: str, recording: str) -> dict[str, Any]:
    """A recording's row as GGIR's parts 1 and 2 take it (wadpac/GGIR, g.part1.R, backup.cal.coef):
    triples in the order of their columns, and NA, or a number, where a number is asked for."""
    head, *lines = csv.reader(StringIO(text))
    rows = [dict(zip(head, line, strict=True)) for line in lines]
    (row,) = [r for r in rows if r["filename"] == recording]
    found: dict[str, Any] = {}
    for name in ("scale", "offset", "temperature.offset"):
        columns = [c for c in head if c in [f"{name}.{a}" for a in "xyz"]]
        assert columns == [f"{name}.{a}" for a in "xyz"]
        found[name] = np.array([float(row[c]) for c in columns])
    for name in ("cal.error.start", "cal.error.end", "n.10sec.windows", "n.hours.considered"):
        found[name] = np.nan if row[name] == "NA" else float(row[name])
    found["use.temperature"] = {"TRUE": True, "FALSE": False}[row["use.temperature"]]
    found["QCmessage"] = row["QCmessage"]
    found["meantempcal"] = float(row["meantempcal"])
    return found


def by_realsense(text: str) -> dict[str, Array]:
    """Four rows of three of each sensor, as IntelRealSense/librealsense,
    tools/rs-imu-calibration.py, saves its X: corrected = (x, y, z, -1) X."""
    (imu,) = json.loads(text)["imus"]
    rows = {name: [*own["scale_and_alignment"], *own["bias"]] for name, own in imu.items()}
    return {name: np.array(row, dtype=float).reshape(4, 3) for name, row in rows.items()}


def by_imu_calib(text: str) -> tuple[Array, Array]:
    """SM and bias as dpkoch/imu_calib, accel_calib.cpp, loads them: corrected = SM raw - bias."""
    data = YAML(typ="safe", pure=True).load(text)
    assert (len(data["SM"]), len(data["bias"])) == (9, 3)
    square = np.zeros((3, 3))
    for i in range(9):
        square[i // 3, i % 3] = float(data["SM"][i])
    return square, np.array(data["bias"], dtype=float)


def by_qgroundcontrol(text: str) -> dict[str, float]:
    """Parameters as QGroundControl's ParameterManager reads a file: five fields between tabs, a
    value of the type that the last one names (MAV_PARAM_TYPE), 6 an int32 and 9 a float."""
    found = {}
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component) == ("1", "1")
        assert len(name) <= 16
        found[name] = {"6": int, "9": float}[kind](value)
    return found


def by_opencv(text: str) -> dict[str, Any]:
    """The block imu0 by OpenCV's FileStorage, with every key that OpenVINS parses
    (rpng/open_vins, ov_core/src/utils/opencv_yaml_parse.h; VioManagerOptions.h)."""
    import cv2

    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    node = storage.getNode("imu0")
    found: dict[str, Any] = {}
    names: list[str] = node.keys()
    for key in names:
        own = node.getNode(key)
        if own.isSeq():
            rows = [own.at(i) for i in range(own.size())]
            found[key] = np.array([[r.at(j).real() for j in range(r.size())] for r in rows])
        else:
            found[key] = own.string() if own.isString() else own.real()
    needed = [f"{sensor}_{n}" for sensor in ("accelerometer", "gyroscope") for n in _NOISE]
    for key in (*needed, "rostopic", "Tw", "Ta", "R_IMUtoACC", "R_IMUtoGYRO", "Tg", "model"):
        assert key in found, key
    return found


def by_octave(script: str, *expressions: str) -> list[Any]:
    """Values of expressions after a script, as GNU Octave (7 or later) works them out."""
    lines = [script, *(f"disp(jsonencode({e}));" for e in expressions)]
    done = subprocess.run(
        ["octave-cli", "--norc", "--quiet"], input="\n".join(lines), text=True, capture_output=True,
        check=True, timeout=120,
    )  # fmt: skip
    assert not done.stderr, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]
