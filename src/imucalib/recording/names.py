"""Names of sensors, topics, effects and units: what they may be made of, wherever they come from.

They end in headers, scripts, launch files and tables that other programs read, so a name has none
of the characters that end a string or a comment anywhere: no quotes, no backslash, no control
character, no ; { } < > $ & | ! ? and no comment.
"""

from __future__ import annotations

import unicodedata

#: Beside letters, digits and their marks, in any script: what names of topics, frames, columns,
#: effects and units have.
_MARKS = frozenset(" _-.:/@#+,()[]=~^*%°·⁻√±×−‰′″→…")
_COMMENTS = ("/*", "*/", "//")
_LONGEST = 200
_FORMULA = tuple("=+-@\t")


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
