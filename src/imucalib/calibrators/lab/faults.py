"""Slips of hand in the bench's sheet, looked for before anything is fitted, and doubts after it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import product
from typing import get_args, get_type_hints

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.lab.bench import (
    NOISE,
    PreparedTable,
    RawUnit,
    in_degrees,
    number_settings,
)
from imucalib.calibrators.lab.calibrate import LabResult
from imucalib.calibrators.lab.errors import setting_noise
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.angle_conventions import Conventions
from imucalib.core.observations import Observations
from imucalib.core.sphere import KnownDirection
from imucalib.errors import UnreadableInput, UsageError
from imucalib.posterior.record_errors import RecordError
from imucalib.posterior.sheet.conventions import (
    Misread,
    as_meant,
    misread_angles,
    nearest_axes,
    wrong_directions,
)
from imucalib.posterior.sheet.converter import (
    CutOff,
    find_cut_offs,
    find_mistaken_scale,
    flat_tops,
    rows_of,
    step_of,
)
from imucalib.posterior.sheet.sheet import Fault, Sheet, in_order
from imucalib.posterior.slips.trials import Written
from imucalib.question import Question, paste
from imucalib.units import DEG, MG

#: What a dial or a column may be read wrongly by, without any misfit.
_SILENT = ("toolface_sense", "toolface_zero_axis", "z_axis")
#: Scatter of a bench's settings (deg) that is none of hands, three times what they set angles to,
#: and how far held-out errors must lie below the raw readings' to be worth their name.
SCATTER, WORTH = 3.0 * NOISE.setting / DEG, 0.9


def _misread(sheet: Sheet, misread: Misread, request: LabRequest) -> Question:
    """What the angle columns mean, and the options that say so."""
    meaning, stated = misread.meaning, request.conventions
    words, options, otherwise = [], list[str](), ""
    if meaning.exchanged:
        words.append("exchanged")
        options += ["--swap-angles"] * (not request.swap_angles)
        otherwise = "run without --swap-angles" * request.swap_angles
    if meaning.radians:
        words.append("read as radians")
        options += ["--angle-unit", "rad"]
    if meaning.vertical:
        vertical = stated.inclination_zero == "vertical"
        other = replace(stated, inclination_zero="horizontal" if vertical else "vertical")
        words.append(f"with inclination from the {other.inclination_zero}")
        # The rest of a convention goes with it.
        meant = as_meant(sheet, meaning._replace(vertical=False))
        straight = None if meant is None else _find_straight(meant, other)
        options += _options(stated, straight or other)
    steps = {"inclination": meaning.inclination_steps, "tool_face": meaning.tool_face_steps}
    for name, step in steps.items():
        if step:
            words.append(f"with {name.replace('_', '-')} one row {'late' if step > 0 else 'early'}")
            options += ["--shift", f"{name}={step}"]
    sentence = (
        f"the angle columns fit far better {' and '.join(words)}: {misread.misfit:.0f} instead of "
        f"{misread.as_given:.0f} mg rms"
    )
    return Question(sentence, tuple(options), otherwise)


def _options(stated: Conventions, other: Conventions) -> list[str]:
    return [
        word
        for name in ("inclination_zero", *_SILENT)
        if getattr(other, name) != getattr(stated, name)
        for word in (f"--{name.replace('_', '-')}", getattr(other, name))
    ]


def _find_straight(sheet: Sheet, like: Conventions) -> Conventions | None:
    """The conventions nearest to some under which the sensor is straight in the tool."""
    hints = get_type_hints(Conventions)
    values = [get_args(hints[name]) for name in _SILENT]
    every = [replace(like, **dict(zip(_SILENT, v, strict=True))) for v in product(*values)]
    every.sort(key=lambda c: len(_options(like, c)))
    for other in every:
        axes = nearest_axes(replace(sheet, inside=other.inside))
        if axes is not None and axes.straight:
            return other
    return None


def _axes_questions(sheet: Sheet, request: LabRequest) -> tuple[Question, ...]:
    """A sensor that does not stand straight in the tool: mounted so, or misread? UnreadableInput
    where no mounting does it."""
    axes = nearest_axes(sheet)
    if axes is None or axes.straight:
        return ()
    stated, before = request.conventions, request.repairs.axes
    straight = _find_straight(sheet, stated)
    dial = tuple(_options(stated, straight)) if straight else ()
    # In terms of the sheet's columns, where some were stated already.
    over = axes.text.split(",")
    under = [(before or ("x", "y", "z"))["xyz".index(part[-1])] for part in over]
    signs = (part[:-1] != b[:-1] for part, b in zip(over, under, strict=True))
    columns = ("-" * sign + b[-1] for sign, b in zip(signs, under, strict=True))
    line = f"--axes={','.join(columns)}"
    if axes.mirrored:
        raise UnreadableInput(
            "the readings are a mirror image of the angles: "
            "an axis or the tool-face has the other sign",
            remedy=f"mend the columns with {line}" + ", or say how the dial turns" * bool(dial),
            add=dial or (line,),
        )
    if before:
        return ()
    turned = f"the sensor stands turned by 90 or 180 deg in the tool (its axes as {axes.text})"
    other = f"{paste(*dial)} or {line}" if dial else line
    other += " if columns or dial are misread"
    return (Question(turned, ("--axes=x,y,z",), other),)


@dataclass(frozen=True)
class Faults:
    """What was found. slips : row by row; questions : what only the user can know
    notes : what else was seen of the sheet; written : it, where slips can be read in it"""

    slips: tuple[Fault, ...] = ()
    questions: tuple[Question, ...] = ()
    notes: tuple[str, ...] = ()
    written: Written | None = None

    def with_axes(self, request: LabRequest) -> Faults:
        """With what is open of the axes of the whole sheet, which say nothing where those of a part
        are turned, or a setting is wrong. Raises UnreadableInput where they are mirrored."""
        turned = any(slip.kind in ("axes", "setting") for slip in self.slips)
        if self.written is None or turned:
            return self
        found = _axes_questions(self.written.sheet, request)
        return replace(self, questions=(*self.questions, *found))

    def list_questions(self, records: tuple[RecordError, ...]) -> tuple[Question, ...]:
        """What the search's own records do not ask already."""
        said = {r.where for r in records}
        slips = (f for f in self.slips if f.kind != "cell" or f"row {f.rows[0]}" not in said)
        return (*(f.question for f in slips), *self.questions)


def sheet_of(prepared: PreparedTable, request: LabRequest) -> Sheet:
    """The kept rows as the search for slips sees them; angles in rad become degrees."""
    table, rows, inside = prepared.table, prepared.rows, request.conventions.inside
    columns = in_degrees(table).columns
    dial = {role: columns[role][rows] for role in ("inclination", "tool_face")}
    timed = "time" in table and bool(np.all(np.diff(table.columns["time"]) > 0.0))
    ordered = timed or in_order(*inside(dial["inclination"], dial["tool_face"]))

    def number(role: str) -> Index:
        if f"{role}_setting" in table:
            return np.unique(columns[f"{role}_setting"][rows], return_inverse=True)[1]
        return number_settings(dial[role]) if ordered else np.arange(rows.size)

    return Sheet(
        reading=prepared.whole.reading[rows, 0] / MG,
        inclination=dial["inclination"],
        tool_face=dial["tool_face"],
        row=table.row[rows],
        place=rows,
        gravity=request.gravity / MG,
        inclination_setting=number("inclination"),
        tool_face_setting=number("tool_face"),
        inside=inside,
        ordered=ordered,
    )


def _order_note(table: PositionTable, rows: Index) -> tuple[str, ...]:
    """Of rows in no order of work whose neighbours count as sharing a setting."""
    guessed = [
        role
        for role in ("inclination", "tool_face")
        if f"{role}_setting" not in table
        and number_settings(table.columns[role][rows])[-1] + 1 < rows.size
    ]
    if not guessed:
        return ()
    names = " and ".join(role.replace("_", "-") for role in guessed)
    columns = " and ".join(f"{role}_setting" for role in guessed)
    return (
        f"the rows stand in no order of work: neighbours of equal {names} count as set once, so "
        f"another order gives other numbers; sort them, or give a column time, or {columns}",
    )


def look_for_faults(prepared: PreparedTable, request: LabRequest) -> Faults:
    """Every slip that the kept rows show. Raises UsageError where the angle columns mean something
    else (`keep_angles` makes it a question)."""
    table, whole, rows = prepared.table, prepared.whole, prepared.rows
    reading, reference = whole.reading[rows, 0] / MG, whole.reference
    if request.reference != "vector":
        questions = _converter_questions(_ends(reading), table, rows)
        if not isinstance(reference, KnownDirection):
            return Faults(questions=questions)
        # Rows whose reading belongs to another of the directions.
        slips = wrong_directions(reading, reference.direction[rows], table.row[rows])
        return Faults(slips, questions)
    sheet = sheet_of(prepared, request)
    questions = _converter_questions(_ends(reading, sheet.truth()), table, rows)
    misread = misread_angles(sheet)
    if misread is not None:
        meant = _misread(sheet, misread, request)
        if misread.meaning.inclination_steps or misread.meaning.tool_face_steps:
            line = paste(*meant.options)
            fault = Fault("convention", meant.what, (), misread.score, line)
            return Faults((fault,), questions)
        if not request.keep_angles:
            say = meant.otherwise or "say what they mean"
            remedy = f"insist on them with --keep-angles, or {say}"
            raise UsageError(meant.what, where=table.path, remedy=remedy, add=meant.options)
        questions += (meant,)
    degree = [DEG if table.unit.get(r) == "rad" else 1.0 for r in ("inclination", "tool_face")]
    return Faults(
        questions=questions,
        notes=() if sheet.ordered else _order_note(table, rows),
        written=Written(sheet, table.raw(), (degree[0], degree[1])),
    )


def _ends(reading: Array, truth: Array | None = None) -> tuple[CutOff, ...]:
    """Ends at which readings stop: exactly, or within noise where that tells more rows."""
    exact, about = find_cut_offs(reading, truth), flat_tops(reading, truth)
    return about if rows_of(about).size > rows_of(exact).size else exact


def _converter_questions(
    ends: tuple[CutOff, ...], table: PositionTable, rows: Index
) -> tuple[Question, ...]:
    ranges: dict[str, list[CutOff]] = {}
    for end in ends:
        ranges.setdefault(f"{abs(end.value):.1f}", []).append(end)
    found = []
    for size, found_ends in ranges.items():
        cut = rows_of(found_ends)
        numbers = ",".join(str(int(table.row[rows[k]])) for k in cut)
        axes = ", ".join(dict.fromkeys("xyz"[end.axis] for end in found_ends))
        signs = {np.sign(end.value) for end in found_ends}
        sign = "±" if len(signs) == 2 else "-" if -1.0 in signs else ""
        what = f"{axes} ends at {sign}{size} mg in rows {numbers}: the sensor is saturated there"
        found.append(Question(what, ("--exclude", numbers)))
    return tuple(found)


def list_doubts(result: LabResult, raw: RawUnit, request: LabRequest) -> tuple[Question, ...]:
    """What no bench can be, once fitted: settings beyond a hand's, a unit guessed wrong."""
    found, how = [], "take more settings of it, and compare the sheet with the notes"
    search = () if request.loop else ("--loop",)
    for name, sd in setting_noise(result.final).items():
        if sd / DEG > SCATTER:
            what = (
                f"{name}s scatter by {sd / DEG:.1f} deg, hands set within {SCATTER:.1g}: the dial "
                "or rows are off in a way that these settings cannot show"
            )
            found.append(Question(what, search, how))
    model = result.final.model
    slices = model.slices(result.final.observations.context)
    guessed = request.unit is None and request.lsb_per_g is None and "norm at rest" in raw.sentence
    if guessed and "scale" in slices:
        counts = find_mistaken_scale(raw.name, result.final.theta[slices["scale"]])
        if counts is not None:
            what = (
                f"the unit {raw.name} was guessed, and all three axes read as if they had "
                f"{counts:.10g} counts a g"
            )
            options = ("--unit", "counts", "--lsb", f"{counts:.10g}")
            found.append(Question(what, options, f"--unit {raw.name}"))
    for name in sorted(set(model.names) - set(request.declare)):
        if session := re.fullmatch(r"session@(\d+):sensor", name):
            what = (
                f"session {session[1]} has scale factors and angles between its axes of its own, "
                "if it was the same sensor"
            )
            found.append(Question(what, ("--declare", name), "leave it out"))
    return tuple(found)


def worthless(result: LabResult, whole: Observations) -> tuple[str, ...]:
    """Reasons not to pass: no better than the raw reading, or in steps far above the noise."""
    found = []
    held = result.error.held_out
    if np.isfinite(held.final) and not held.final < WORTH * held.raw:
        found.append(
            f"held-out error {held.final:.3g} mg is not clearly below the raw reading's "
            f"{held.raw:.3g} mg"
        )
    step = step_of(whole.reading[:, 0] / MG)
    if step:
        found.append(f"readings come in steps of {step:.3g} mg: average more samples")
    return tuple(found)
