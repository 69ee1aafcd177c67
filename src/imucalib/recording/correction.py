"""The mark that a corrected recording carries: which sensor, by which calibration."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Correction:
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
        return (
            f"{self.triad} is corrected by a calibration of {self.calibrator} ({self.sha256[:12]})"
        )


def corrections_of(texts: Iterable[str]) -> tuple[Correction, ...]:
    """The marks that a file's header states, each once; what is no such line is passed over."""
    found = []
    for text in texts:
        try:
            parts = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(parts, list) and len(parts) == 3 and all(isinstance(p, str) for p in parts):
            found.append(Correction(*parts))
    return tuple(dict.fromkeys(found))
