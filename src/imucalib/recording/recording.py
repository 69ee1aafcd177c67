"""A recording: time series as they were read, units known, provenance, losses and corrections."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from imucalib.arrays import Array
from imucalib.recording.onboard import Onboard

#: Quantity of a channel of rests, at their middles, and its columns: s; m/s², mean reading and
#: corrected one; mg, by how much the size of both is beyond gravity.
REST = "rest"
REST_COLUMNS = (
    "duration",
    *(f"{which}.{axis}" for which in ("before", "after") for axis in "xyz"),
    "residual_before",
    "residual_after",
)


#: What the note on a corrected sensor says.
CORRECTED = "is corrected by a calibration of"


@dataclass(frozen=True)
class AppliedCalibration:
    """One calibration that was applied.

    triad : the sensor whose acceleration was corrected
    calibrator : what made the calibration ("lab", ...); sha256 : of the calibration's file
    """

    triad: str
    calibrator: str
    sha256: str

    def to_text(self) -> str:
        """One line of ASCII for any format's header."""
        return json.dumps([self.triad, self.calibrator, self.sha256])

    def __str__(self) -> str:
        return f"{self.triad} {CORRECTED} {self.calibrator} ({self.sha256[:12]})"


def corrections_of(texts: Iterable[str]) -> tuple[AppliedCalibration, ...]:
    """The marks that a file's header states, each once; what is no such line is passed over."""
    found = []
    for text in texts:
        try:
            parts = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(parts, list) and len(parts) == 3 and all(isinstance(p, str) for p in parts):
            found.append(AppliedCalibration(*parts))
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True)
class Channel:
    """One quantity of one sensor triad over time.

    t : (N,) seconds since the recording's start, non-decreasing within a gap-free part
    values : (N, k) in SI units (m/s², rad/s, °C), or raw counts when `unit` is "counts"
    quantity : "acceleration", "angular_rate", "temperature", or a name from the file
    triad : the sensor that it belongs to, for example "imu0"
    names : what else the file calls that sensor, in full: topic or dataset, then its frame_id
    numbered : whether `triad` is only a number, since the file has no name for the sensor
    topic : of messages, which it came in
    raw_unit, raw_to_si, raw_zero : unit of the numbers in the file, `unit` in one of it, and what
        is taken off them before, (1,) or one an axis
    rate : samples a second, over all that no gap interrupts (or of the file's header)
    onboard : what a flight controller did to it, where its log says so
    """

    t: Array
    values: Array
    unit: str
    quantity: str
    triad: str
    rate: float
    names: tuple[str, ...] = ()
    numbered: bool = False
    topic: str = ""
    raw_unit: str = ""
    raw_to_si: tuple[float, ...] = ()
    raw_zero: tuple[float, ...] = ()
    onboard: Onboard | None = None

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.t.shape != self.values.shape[:1]:
            raise ValueError(f"channel shapes differ: t {self.t.shape}, values {self.values.shape}")


@dataclass(frozen=True)
class Gap:
    """An interval without samples: no still segment and no derivative may cross it."""

    start: float
    stop: float
    reason: str


@dataclass(frozen=True)
class HeldSamples:
    """Samples of a channel, by its name, between two times (s) that repeat one reading: held,
    copied or filled in, and no measurement."""

    channel: str
    start: float
    stop: float


@dataclass(frozen=True)
class Count:
    """What became of the samples of one source: a table's rows, a topic's messages, a dataset's.

    held : in the file; read : of them, whole; left : others by why, which a note tells as well
    """

    source: str
    held: int
    read: int
    left: Mapping[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        others = "".join(f" + {count} {why}" for why, count in self.left.items() if count)
        return f"{self.source}: {self.held} in the file = {self.read} read{others}"


@dataclass(frozen=True)
class Recording:
    """Channels by name ("imu0/acceleration"), with where they come from and what was lost.

    start_ns : UTC time of t = 0, int64 nanoseconds since 1970, or None when the file has no date
    notes : what was detected, repaired or lost, one sentence each, for the reports
    mapping : the resolved mapping (column or topic -> channel, unit, ...) that read the file
    corrections : calibrations that were applied to it, as the file itself says
    held : stretches that repeat one reading as the channel's noise never does
    counts : what became of every sample in the file; of the last block, for the whole file
    device, serial : kind and number of the device, where the file names it
    """

    channels: Mapping[str, Channel]
    path: str
    format: str
    sha256: str
    start_ns: int | None = None
    gaps: tuple[Gap, ...] = ()
    notes: tuple[str, ...] = ()
    mapping: Mapping[str, object] = field(default_factory=dict)
    corrections: tuple[AppliedCalibration, ...] = ()
    held: tuple[HeldSamples, ...] = ()
    counts: tuple[Count, ...] = ()
    device: str = ""
    serial: str = ""
