"""Where a result comes from: enough to compute it again."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from imucalib import __version__
from imucalib.data import Data


class Origin(Data, kw_only=True):
    """Where the numbers come from; enough to compute them again."""

    input: str
    sha256: str
    inputs_sha256: Annotated[tuple[str, ...] | None, "Of each file, where it is several."] = None
    samples: int
    gaps: int
    mapping: Annotated[Mapping[str, Any], "How it was read."]
    settings: Mapping[str, Any]
    command: Annotated[str, "That was typed."]
    seed: int
    versions: Mapping[str, str]
    time: str


@dataclass(frozen=True)
class Provenance:
    """Where the numbers come from; enough to compute them again.

    path : name of the input; sha256 : of it; parts : of each file where it is several
    mapping : how it was read; command : the line that was typed, or empty
    """

    path: str
    sha256: str
    samples: int
    gaps: int
    mapping: Mapping[str, object]
    settings: Mapping[str, object]
    seed: int
    versions: Mapping[str, str]
    time: str
    command: str = ""
    parts: tuple[str, ...] = ()

    @property
    def footer(self) -> tuple[tuple[str, str], ...]:
        """What is at the foot of every report."""
        return (
            ("input", f"{self.path}, sha256 {self.sha256[:16]}…"),
            *((("command", self.command),) if self.command else ()),
            ("seed", str(self.seed)),
            ("versions", ", ".join(f"{k} {v}" for k, v in self.versions.items())),
            ("time", self.time),
        )

    @property
    def described(self) -> Origin:
        """As report.json has it."""
        return Origin.of(self, "input=path", inputs_sha256=self.parts or None)

    def as_dict(self) -> dict[str, Any]:
        """The block of calibration.yaml and report.json."""
        return self.described.as_dict()


def provenance_of(
    *,
    path: str,
    sha256: str,
    samples: int,
    mapping: Mapping[str, object],
    settings: Mapping[str, object],
    seed: int = 0,
    gaps: int = 0,
    command: str = "",
    parts: tuple[str, ...] = (),
) -> Provenance:
    """The provenance of a run that ends now, on this machine."""
    import scipy

    versions = {
        "imucalib": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    return Provenance(
        path=Path(path).name,
        sha256=sha256,
        samples=samples,
        gaps=gaps,
        mapping=mapping,
        settings=settings,
        seed=seed,
        versions=versions,
        time=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        command=command,
        parts=parts,
    )
