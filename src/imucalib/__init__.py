"""imucalib: calibrate inertial sensors from recorded logs (command `imucal`)."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("imucalib")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
