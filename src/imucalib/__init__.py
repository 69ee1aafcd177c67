"""imucalib: calibrate inertial sensors from recorded logs (command `imucal`).

    import imucalib
    found = imucalib.lab("positions.csv", gravity=9.8061)
    found.calibration.apply(reading)  # (n, 3), in the unit of the table

What stands in `__all__` is imported when it is first asked for.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imucalib.api.calibrators import actigraph, array, imu, lab, load, read
    from imucalib.api.result import Result
    from imucalib.calibration.calibration import Calibration
    from imucalib.recording.mapping import FieldMapping
    from imucalib.recording.recording import Recording

try:
    __version__ = version("imucalib")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

__all__ = [
    "Calibration",
    "FieldMapping",
    "Recording",
    "Result",
    "__version__",
    "actigraph",
    "array",
    "imu",
    "lab",
    "load",
    "read",
]
_HOMES = {
    "Calibration": "calibration.calibration",
    "FieldMapping": "recording.mapping",
    "Recording": "recording.recording",
    "Result": "api.result",
} | dict.fromkeys(("actigraph", "array", "imu", "lab", "load", "read"), "api.calibrators")


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'imucalib' has no attribute '{name}'")
    found = getattr(import_module(f"imucalib.{_HOMES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
