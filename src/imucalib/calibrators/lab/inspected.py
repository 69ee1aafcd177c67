"""What a table of positions holds, before anything is calibrated, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from imucalib.calibrators.lab.bench import raw_unit
from imucalib.calibrators.lab.checks import (
    implausible_sizes,
    kept_rows,
    observations_of,
    refuse_sizes,
    refuse_units,
    warmth_note,
)
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.faults import look_for_faults
from imucalib.calibrators.lab.files import ANGLES, LabFiles, positions_in
from imucalib.calibrators.lab.position_table import PositionTable, read_position_table, roles_in
from imucalib.calibrators.lab.request import LabRequest
from imucalib.errors import ImucalError
from imucalib.recording.mapping import FieldMapping

Kind = Literal["vector", "direction", "norm", "plan"]
#: Share of a reading by which the next one differs where rows are positions, and no samples.
_TURNED = 0.05


@dataclass(frozen=True)
class TableSeen:
    """A table and how `lab` would read it.

    kind : the reference that its columns give; a plan has angles alone; unit : of the readings, and
    how it is known; wrong : (what, what to do about it)
    """

    table: PositionTable
    kind: Kind
    unit: str
    wrong: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()


def inspect_table(path: Path, mapping: FieldMapping) -> TableSeen | None:
    """A table of positions as it would be read, or None where a file is none. Raises
    UnreadableInput where headings say that it is one and its cells cannot be read."""
    try:
        roles = roles_in(path, mapping)
    except ImucalError:
        return None
    if roles >= ANGLES:
        whole = set("xyz") <= roles
        table = read_position_table(path, need_raw=whole, mapping=mapping)
        return _seen(table, "vector" if whole else "plan", mapping)
    found = positions_in(LabFiles(path, mapping=mapping))
    if found is None or not _turned(found):
        return None
    return _seen(found, "direction" if "ux" in found else "norm", mapping)


def _turned(table: PositionTable) -> bool:
    """Whether the readings of neighbouring rows differ as positions do, or a column names faces."""
    raw = table.raw()
    if "ux" in table or len(raw) < 2:
        return "ux" in table
    steps = np.linalg.norm(np.diff(raw, axis=0), axis=1)
    return float(np.median(steps)) > _TURNED * float(np.median(np.linalg.norm(raw, axis=1)))


def _seen(table: PositionTable, kind: Kind, mapping: FieldMapping) -> TableSeen:
    notes = (*table.left_out, *warmth_note(table))
    if kind == "plan":
        return TableSeen(table, kind, "", (), notes)
    wrong, unit = list[tuple[str, str]](), ""
    request = LabRequest(reference=kind, unit=mapping.acc_unit or None)
    if table.inclination_zero == "vertical":
        settings = replace(request.settings, conventions=Conventions(inclination_zero="vertical"))
        request = replace(request, settings=settings)
    lsb = mapping.lsb_per_g
    try:
        rows = kept_rows(table, ())
        refuse_units(table, rows)
        raw = raw_unit(table, request.unit, float(lsb[0]) if lsb else None)
        unit = raw.sentence
        refuse_sizes(table, implausible_sizes(table, rows), rows)
        whole = observations_of(table, raw, request)
        faults = look_for_faults(table, raw, whole, rows, request).of_axes(request)
        notes += faults.notes
        for text in faults.undecided(()):
            what, _, remedy = text.partition("; decide with ")
            wrong.append((what, remedy))
    except ImucalError as error:
        where = error.where.removeprefix(table.path).lstrip(", ")
        wrong.append((f"{where}: {error.what}" if where else error.what, error.remedy))
    return TableSeen(table, kind, unit, tuple(wrong), notes)
