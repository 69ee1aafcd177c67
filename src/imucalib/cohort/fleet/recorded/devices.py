"""Which recordings are of the same device."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from imucalib.cohort.fleet.recorded.calibrated import Calibrated
from imucalib.errors import UnreadableInput

#: Headings of the two columns, the first that is there: `imucal collect` writes the last ones.
_RECORDING, _DEVICE = ("recording", "path"), ("device", "serial")


def read_devices(path: Path) -> dict[str, str]:
    """Recording -> device. Raises UnreadableInput for what is no such table."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnreadableInput(f"cannot be read: {error}", where=str(path)) from None
    heading = list(rows[0]) if rows else []
    picked = [next((n for n in names if n in heading), None) for names in (_RECORDING, _DEVICE)]
    if None in picked:
        raise UnreadableInput(
            "it says of no recording which device made it",
            where=str(path),
            remedy="a CSV with the columns recording and device, as `imucal collect` writes it "
            "with serial",
        )
    recording, device = (str(name) for name in picked)
    named = {row[recording]: row[device] for row in rows if row[device]}
    often = Counter(Path(name).name for name in named)
    short = {Path(n).name: d for n, d in named.items() if often[Path(n).name] == 1}
    return {**short, **named}


def with_devices(found: Sequence[Calibrated], named: Mapping[str, str]) -> tuple[Calibrated, ...]:
    """Every recording with its device: as named, as its file says, or a device by itself.

    Raises UnreadableInput where some are named and others are not.
    """
    own = {one.name: named.get(one.recording) or named.get(one.provenance.path) for one in found}
    absent = [one.recording for one in found if named and own[one.name] is None]
    if absent:
        raise UnreadableInput(
            f"no device is named for {', '.join(absent[:3])}"
            + (f" and {len(absent) - 3} more" if len(absent) > 3 else ""),
            remedy="add these recordings to the table of --devices, by the paths of their files",
        )
    return tuple(replace(one, device=own[one.name] or one.device or one.name) for one in found)
