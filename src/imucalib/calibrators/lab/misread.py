"""Columns that mean something else, in words, with the options that say what they mean."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import get_args, get_type_hints

from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.request import LabRequest
from imucalib.errors import UnreadableInput
from imucalib.loop.faults.conventions import Misread, as_meant, nearest_axes
from imucalib.loop.faults.sheet import Sheet

#: What a dial or a column may be read wrongly by, without any misfit.
_SILENT = ("toolface_sense", "toolface_zero_axis", "z_axis")


def misread_words(sheet: Sheet, misread: Misread, request: LabRequest) -> tuple[str, str]:
    """What the angle columns mean, and the options that say so."""
    meaning, stated = misread.meaning, request.settings.conventions
    words, options = [], []
    if meaning.exchanged:
        words.append("exchanged")
        options.append("run without --swap-angles" if request.swap_angles else "--swap-angles")
    if meaning.radians:
        words.append("read as radians")
        options.append("--angle-unit rad")
    if meaning.vertical:
        other = _from_the_other_end(stated)
        words.append(f"with inclination from the {other.inclination_zero}")
        options += _vertical_options(sheet, misread, stated, other)
    steps = (meaning.inclination_steps, meaning.tool_face_steps)
    for name, step in zip(("inclination", "tool_face"), steps, strict=True):
        if step:
            words.append(f"with {name.replace('_', '-')} one row {'late' if step > 0 else 'early'}")
            options.append(f"--shift {name}={step}")
    sentence = (
        f"the angle columns fit far better {' and '.join(words)}: {misread.misfit:.0f} instead of "
        f"{misread.as_given:.0f} mg rms"
    )
    return sentence, " ".join(options)


def _from_the_other_end(stated: Conventions) -> Conventions:
    if stated.inclination_zero == "vertical":
        return replace(stated, inclination_zero="horizontal")
    return replace(stated, inclination_zero="vertical")


def _vertical_options(
    sheet: Sheet, misread: Misread, stated: Conventions, other: Conventions
) -> list[str]:
    """The zero of inclination, with the rest of a convention that goes with it."""
    meant = as_meant(sheet, misread.meaning._replace(vertical=False))
    straight = None if meant is None else _standing_straight(meant, other)
    return _options(stated, straight or other)


def _options(stated: Conventions, other: Conventions) -> list[str]:
    return [
        f"--{name.replace('_', '-')} {getattr(other, name)}"
        for name in ("inclination_zero", *_SILENT)
        if getattr(other, name) != getattr(stated, name)
    ]


def _standing_straight(sheet: Sheet, like: Conventions) -> Conventions | None:
    """The conventions nearest to some under which the sensor stands straight in the tool."""
    hints = get_type_hints(Conventions)
    values = [get_args(hints[name]) for name in _SILENT]
    every = [replace(like, **dict(zip(_SILENT, v, strict=True))) for v in product(*values)]
    every.sort(key=lambda c: len(_options(like, c)))
    for other in every:
        axes = nearest_axes(replace(sheet, inside=other.inside))
        if axes is not None and axes.straight:
            return other
    return None


def axes_questions(sheet: Sheet, request: LabRequest) -> tuple[str, ...]:
    """A sensor that does not stand straight in the tool: mounted so, or misread? UnreadableInput
    where no mounting does it."""
    axes = nearest_axes(sheet)
    if axes is None or axes.straight:
        return ()
    stated, before = request.settings.conventions, request.repairs.axes
    straight = _standing_straight(sheet, stated)
    lines = [" ".join(_options(stated, straight))] if straight else []
    lines.append(f"--axes={_composed(axes.text.split(','), before or ('x', 'y', 'z'))}")
    if axes.mirrored:
        raise UnreadableInput(
            "the readings are a mirror image of the angles: "
            "an axis or the tool-face has the other sign",
            remedy=f"which one only you can know: {' or '.join(lines)}",
        )
    if before:
        return ()
    return (
        f"the sensor would be mounted near 90 or 180 deg in the tool (its axes as {axes.text}): if "
        f"columns or dial are misread, {' or '.join(lines)}; if it is mounted so, --axes=x,y,z",
    )


def _composed(over: list[str], under: tuple[str, ...]) -> str:
    """Axes in terms of the sheet's columns where some were stated already."""
    below = [under["xyz".index(part[-1])] for part in over]
    signs = [part[:-1] != b[:-1] for part, b in zip(over, below, strict=True)]
    return ",".join("-" * s + b[-1] for s, b in zip(signs, below, strict=True))
