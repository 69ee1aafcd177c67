"""When each calibration was recorded, in days, and where that is known from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.errors import UsageError

#: Days between the first and the last from which on times of the runs stand in for recordings.
_APART = 1.0


@dataclass(frozen=True)
class Dates:
    """days : (m,) since the first; start : of the first; words : where they are from"""

    days: Array
    start: datetime
    words: str


def dates_of(calibrations: Sequence[Calibration], stated: Sequence[str]) -> Dates | None:
    """As stated, else as the recordings say, else by the runs where these lie days apart; None
    where none of this tells a difference. Raises UsageError for dates that are none."""
    if stated:
        if len(stated) != len(calibrations):
            raise UsageError(
                f"{len(stated)} dates for {len(calibrations)} calibrations",
                remedy="give one a file, in their order: --dates 2026-01-31,2026-07-31",
            )
        found = _dates([_parsed(text) for text in stated], "dates as given")
        if found is None:
            raise UsageError("all dates are the same: nothing can drift between them",
                             remedy="leave out --dates, or give the times of day")  # fmt: skip
        return found
    starts = [(c.facts.get("clock") or {}).get("start_ns") for c in calibrations]
    if all(isinstance(s, int) for s in starts):
        known = [datetime.fromtimestamp(s / 1e9, UTC) for s in starts if s is not None]
        return _dates(known, "dates as the recordings have them")
    runs = [(c.facts.get("provenance") or {}).get("time") for c in calibrations]
    when = [_parsed(r) for r in runs if isinstance(r, str)]
    if len(when) < len(runs):
        return None
    found = _dates(when, "dates are those of the runs of imucal, not of the "
                   "recordings, which state none (--dates)")  # fmt: skip
    return found if found is not None and np.ptp(found.days) >= _APART else None


def _parsed(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"'{text}' is no date", remedy="write it as 2026-07-31 or 2026-07-31T12:00:00Z"
        ) from None
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def _dates(when: list[datetime], words: str) -> Dates | None:
    first = min(when)
    days = np.array([(w - first).total_seconds() / 86400.0 for w in when])
    return Dates(days, first, words) if np.ptp(days) > 0.0 else None
