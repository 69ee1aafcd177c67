"""Names of sensors, and whose readings are whose: sensors paired with those of a board.

A recording's sensor is called by `Channel.triad`, unless that is only a number that a reader gave,
and by `Channel.names`: its topic, dataset, column, frame_id. A name counts where no other sensor
of the recording has it, and so does a part of one: "imu_fl" of /imu_fl/data_raw.

Names end in headers, scripts, launch files and tables that other programs read, so a name has none
of the characters that end a string or a comment anywhere: no quotes, no backslash, no control
character, no ; { } < > $ & | ! ? and no comment.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imucalib.errors import UnreadableInput
from imucalib.recording.recording import Recording

#: Beside letters, digits and their marks, in any script: what names of topics, frames, columns,
#: effects and units have.
_MARKS = frozenset(" _-.:/@#+,()[]=~^*%°·⁻√±×−‰′″→…")
_COMMENTS = ("/*", "*/", "//")
_LONGEST = 200
_FORMULA = tuple("=+-@\t")
_SEPARATORS = re.compile(r"[/:\[\]]+")


def fault(name: str) -> str:
    """What a name has that no name may have, in words; empty for a sound one."""
    if len(name) > _LONGEST:
        return f"it has {len(name)} characters, more than {_LONGEST}"
    for letter in name:
        if letter not in _MARKS and unicodedata.category(letter)[0] not in "LMN":
            return f"it has the character {letter!a}"
    found = [mark for mark in _COMMENTS if mark in name]
    return f"it has {found[0]}, which begins or ends a comment" if found else ""


def cell(value: object) -> object:
    """A table's cell; a text that a spreadsheet would take for a formula begins with an apostrophe,
    which spreadsheets read as "this is text"."""
    if not isinstance(value, str):
        return value
    value = value.replace("\r", " ")  # which csv leaves bare, to end a row
    return f"'{value}" if value.startswith(_FORMULA) else value


def printable(text: str) -> str:
    """A text, such as a file's name, on one line and without what ends a comment."""
    line = "".join(c if c == " " or unicodedata.category(c)[0] not in "CZ" else "?" for c in text)
    for mark in _COMMENTS:
        line = line.replace(mark, "?".join(mark))
    return line


@dataclass(frozen=True)
class Pairing:
    """partner : a recording's sensor -> the index of the one that it is paired with, in the order
    in which they were wanted; notes : how, where it was not by equal names, and what is left out"""

    partner: Mapping[str, int]
    notes: tuple[str, ...] = ()


def pair(wanted: Sequence[Sequence[str]], recording: Recording, whose: str) -> Pairing:
    """Pair sensors with a recording's accelerometers.

    wanted : of each sensor the names that it goes by, what the user calls it first
    whose : "the board" or "the calibration", for messages
    By order only where no name fits at all and there are as many. Raises UnreadableInput where
    names of both sides have no partner, or nothing fits.
    """
    known, firsts = names_in(recording), [w[0] for w in wanted]
    found = _by_names(wanted, known)
    alone = [r for r in known if r not in found]
    absent = [name for k, name in enumerate(firsts) if k not in found.values()]
    if found and not (alone and absent):
        renamed = [f"{r} is {firsts[k]}" for r, k in found.items() if r != firsts[k]]
        remarks = {
            "paired by name": renamed,
            f"not of {whose}, left as they are": alone,
            f"of {whose}, not in the recording": absent,
        }
        notes = (f"{what}: {', '.join(names)}" for what, names in remarks.items() if names)
        return Pairing(found, tuple(notes))
    if not found and known and len(known) == len(wanted):
        pairs = [f"{r} is {first}" for r, first in zip(known, firsts, strict=True) if r != first]
        note = f"no name of {whose} fits one of the recording: paired in order, {', '.join(pairs)}"
        in_order = dict(zip(known, range(len(wanted)), strict=True))
        return Pairing(in_order, (note,) if pairs else ())
    many = "accelerometer" if len(known) == 1 else "accelerometers"
    what = f"{whose} has {len(wanted)} IMUs, the recording {len(known)} {many}"
    ours, theirs = list_names(absent), list_names(alone)
    if found:
        what += f", and only {len(found)} names fit; left over: {ours}; in the recording "
        what += theirs or "none"
    else:
        what += f", and no name fits: {ours}; in the recording {theirs}"
    raise UnreadableInput(
        what,
        where=recording.path,
        remedy=f"give the sensors the same names on both sides: in {whose}'s file, or by naming "
        "the recording's with a mapping (`imucal inspect --save-mapping`, key triads)",
    )


def names_in(recording: Recording) -> dict[str, frozenset[str]]:
    """Every name of each accelerometer of a recording, parts that are its alone included; none
    where the file has none, so that `triad` is only a number."""
    whole: dict[str, list[str]] = {}
    for channel in recording.channels.values():
        if channel.quantity == "acceleration":
            own = whole.setdefault(channel.triad, [])
            own += channel.names if channel.numbered else (channel.triad, *channel.names)
    return dict(zip(whole, _add_parts(list(whole.values())), strict=True))


def channel_names(recording: Recording) -> dict[str, str]:
    """What the file calls each accelerometer, in full: what a later recording is paired by. Empty
    where that is no name that a calibration may hold."""
    found = {
        c.triad: (c.names or ("" if c.numbered else c.triad,))[0]
        for c in recording.channels.values()
        if c.quantity == "acceleration"
    }
    return {triad: "" if fault(name) else name for triad, name in found.items()}


def _add_parts(sensors: Sequence[Sequence[str]]) -> list[frozenset[str]]:
    """The names of each sensor, and the parts of them, that no other sensor has."""
    every = [{*names, *(p for name in names for p in parts_of(name))} for names in sensors]
    whole = Counter(n for names in sensors for n in set(names))
    count = Counter(p for names in every for p in names)
    return [
        frozenset(n for n in one if (whole if n in own else count)[n] == 1)
        for one, own in zip(every, sensors, strict=True)
    ]


def parts_of(name: str) -> tuple[str, ...]:
    """The words between the separators of a topic or path; numbers alone name nothing."""
    return tuple(p for p in _SEPARATORS.split(name) if p and not p.isdecimal())


def distinct_names(sensors: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """One short name of each sensor out of the topics that it has: the first part that is its
    alone. Empty where one has none: then the file does not tell them apart by name."""
    each = [tuple(dict.fromkeys(p for name in names for p in parts_of(name))) for names in sensors]
    count = Counter(p for parts in each for p in parts)
    found = [next((p for p in parts if count[p] == 1), "") for parts in each]
    return tuple(found) if all(re.fullmatch(r"[\w.~-]+", name) for name in found) else ()


def _by_names(
    wanted: Sequence[Sequence[str]], known: Mapping[str, frozenset[str]]
) -> dict[str, int]:
    """What fits: by the name that each is called first, else by any of its names."""
    found: dict[str, int] = {}
    for names in ([frozenset(w[:1]) for w in wanted], _add_parts(wanted)):
        fits = {r: [k for k, w in enumerate(names) if own & w] for r, own in known.items()}
        once = Counter(k for few in fits.values() for k in few)
        found = {r: few[0] for r, few in fits.items() if len(few) == 1 and once[few[0]] == 1}
        if len(found) in (len(known), len(wanted)):
            break
    return found


def list_names(names: Sequence[str]) -> str:
    """Names in a message, eight at most and how many more."""
    more = len(names) - 8
    return ", ".join(names[:8]) + (f" and {more} more" if more > 0 else "")
