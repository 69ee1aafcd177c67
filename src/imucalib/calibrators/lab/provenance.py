"""What a run of `lab` was made from: enough to compute it again."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from imucalib import __version__
from imucalib.calibration.outcome import Provenance
from imucalib.calibrators.lab.bench import RawUnit
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest


def provenance_of(
    table: PositionTable,
    raw: RawUnit,
    request: LabRequest,
    mapping: Mapping[str, object],
    gaps: int,
) -> Provenance:
    """Where the numbers come from; `mapping` says how the input was read."""
    import scipy

    settings = request.settings
    shown: dict[str, object] = {
        "reference": request.reference,
        "model": settings.model,
        "objective": settings.objective,
        "declare": list(settings.declare),
        "loop": settings.loop,
        "unit": raw.name,
        "gravity_m_per_s2": request.gravity,
        "gravity_source": request.gravity_source,
        "conventions": asdict(request.settings.conventions),
        "fix": [f"{row}:{role}={value!r}" for row, role, value in request.fixes],
        "repairs": {k: v for k, v in asdict(request.repairs).items() if v},
        "exclude": list(request.exclude),
        "auto_exclude": request.auto_exclude,
        "train": list(request.train),
        "swap_angles": request.swap_angles,
        "alpha": settings.rules.alpha,
        "draws": settings.rules.draws,
    }
    versions = {
        "imucalib": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    path = Path(table.path).name
    return Provenance(
        path, table.sha256, table.n, gaps, mapping, shown, request.seed, versions, now
    )
