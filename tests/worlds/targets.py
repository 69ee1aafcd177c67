"""What other programs load an export with: their own reader, or their source's rules once more."""

from __future__ import annotations

from typing import Any

import numpy as np
from ruamel.yaml import YAML

_NOISE = ("noise_density", "random_walk")


def by_kalibr(text: str) -> dict[str, Any]:
    """As ethz-asl/kalibr, kalibr_common/ConfigReader.py, ImuParameters asks of an imu.yaml."""
    data = dict(YAML(typ="safe", pure=True).load(text))
    assert isinstance(data["rostopic"], str)
    assert data["update_rate"] > 0.0
    for key in (f"{sensor}_{n}" for sensor in ("accelerometer", "gyroscope") for n in _NOISE):
        assert data[key] > 0.0, key
    return data


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
