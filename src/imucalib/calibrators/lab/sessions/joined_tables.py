"""Several tables of one sensor, one a power-up, as one table with a column session."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.errors import UsageError


def joined(tables: Sequence[PositionTable]) -> tuple[PositionTable, tuple[str, ...]]:
    """One table whose rows count through all, and notes on what was left out or renumbered.

    Columns that one of them lacks are left out. Raises UsageError for units that differ, for a
    column session beside several files, and for a file that is given twice.
    """
    first, *others = tables
    if not others:
        return first, ()
    for k, one in enumerate(tables):
        _demand_alike(first, one)
        twin = next((o for o in tables[:k] if o.sha256 == one.sha256), None)
        if twin is not None:
            raise UsageError(
                f"the same readings as {twin.path}",
                where=one.path,
                remedy="give each power-up once",
            )
    roles = [role for role in first.columns if all(role in one for one in others)]
    columns = {role: np.concatenate([one.columns[role] for one in tables]) for role in roles}
    columns["session"] = np.repeat(np.arange(len(tables)), [one.n for one in tables]).astype(float)
    whole = replace(
        first,
        columns=columns,
        names={role: name for role, name in first.names.items() if role in roles},
        row=np.arange(1, len(columns["session"]) + 1),
        path=", ".join(Path(one.path).name for one in tables),
        sha256=hashlib.sha256("".join(one.sha256 for one in tables).encode()).hexdigest(),
        sessions=_names(tables),
        files=tuple(one.sha256 for one in tables),
    )
    return whole, _notes(tables, roles)


def _names(tables: Sequence[PositionTable]) -> tuple[str, ...]:
    names = tuple(Path(one.path).stem for one in tables)
    return names if len(set(names)) == len(names) else tuple(one.path for one in tables)


def _demand_alike(first: PositionTable, one: PositionTable) -> None:
    if one.sessions:
        raise UsageError(
            "a column session beside several files",
            where=one.path,
            remedy="give one file with the column, or files without it: each is a session",
        )
    if one.unit != first.unit or one.inclination_zero != first.inclination_zero:
        raise UsageError(
            f"its units {one.unit or 'are not stated'}, those of {first.path} "
            f"{first.unit or 'are not stated'}",
            where=one.path,
            remedy="use the same headings in all files of one sensor",
        )


def _notes(tables: Sequence[PositionTable], roles: Sequence[str]) -> tuple[str, ...]:
    lost = sorted({role for one in tables for role in one.columns} - set(roles))
    last = np.cumsum([one.n for one in tables])
    spans = [
        f"{Path(one.path).name} {end - one.n + 1}-{end}"
        for one, end in zip(tables, last, strict=True)
    ]
    notes = [f"rows count through all files: {', '.join(spans)}"]
    if lost:
        notes.append(f"left out, since not every file has it: {', '.join(lost)}")
    return tuple(notes)
