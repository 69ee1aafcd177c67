"""A report as data: built once by a calibrator, rendered as terminal text or as one HTML file.

A block says what is shown, not how: `report.render` decides the looks.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Literal

from imucalib.arrays import Array
from imucalib.calibration.outcome import KEEP
from imucalib.question import paste

#: Section of the plots of what is left before and after a search.
RESIDUALS = "Residual before and after"
Mark = Literal["line", "points", "rings", "band", "net"]
Tone = Literal["ok", "warning", "bad", "plain"]
#: Heading of a table's column, attribute or what makes its cells, and their format: one with a
#: format stands to the right.
Column = tuple[str, str | Callable[[Any], Any], str]


@dataclass(frozen=True)
class Text:
    """One paragraph; `tone` colours a verdict, a warning or a failure."""

    text: str
    tone: Tone = "plain"

    @classmethod
    def paragraphs(cls, texts: Iterable[str], tone: Tone = "plain") -> tuple[Text, ...]:
        """A paragraph each."""
        return tuple(cls(text, tone) for text in texts)

    @classmethod
    def sentences(cls, texts: Iterable[str], tone: Tone = "plain") -> tuple[Text, ...]:
        """A paragraph each, with its capital and its full stop."""
        return cls.paragraphs((f"{capital(text)}." for text in texts), tone)


def capital(text: str) -> str:
    """The text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Facts:
    """Name and value pairs, in order (local g, file, number of positions, ...)."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Table:
    """A table; numbers are already formatted by the builder so that digits match their sd.

    align : one character a column, "l" or "r"; empty: the first to the left, numbers to the right
    tones : row index -> tone, for rows that the reader must not miss
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    align: str
    note: str = ""
    tones: Mapping[int, Tone] = field(default_factory=dict)

    @classmethod
    def from_columns(
        cls,
        columns: Sequence[Column],
        rows: Iterable[Any],
        title: str = "",
        note: str = "",
        tones: Mapping[int, Tone] | None = None,
    ) -> Table:
        """A row an object; what does not exist is "-"."""
        cells = [tuple(_cell(one, of, form) for _, of, form in columns) for one in rows]
        align = "".join("r" if form else "l" for _, _, form in columns)
        headings = tuple(heading for heading, _, _ in columns)
        return cls(title, headings, tuple(cells), align, note, tones or {})

    @property
    def sides(self) -> str:
        """Where each column stands, "l" or "r"."""
        return self.align or "l" + "r" * (len(self.header) - 1)

    @staticmethod
    def mark_rows(tone: Tone, which: Iterable[bool]) -> dict[int, Tone]:
        """One tone for rows, by whether each is marked."""
        return {k: tone for k, one in enumerate(which) if one}


def _cell(row: Any, of: str | Callable[[Any], Any], form: str) -> str:
    value = attrgetter(of)(row) if isinstance(of, str) else of(row)
    missing = value is None or (isinstance(value, float) and math.isnan(value))
    return "-" if missing else f"{value:{form}}"


@dataclass(frozen=True)
class Series:
    """One data series: x (n,), y (n,); `low` and `high` (n,): edges of a band or of whiskers."""

    label: str
    x: Array
    y: Array
    mark: Mark
    low: Array | None = None
    high: Array | None = None
    names: tuple[str, ...] = ()  # one label a point, shown on hover in HTML

    @classmethod
    def from_half(
        cls, label: str, x: Array, y: Array, half: Array, mark: Mark, names: tuple[str, ...] = ()
    ) -> Series:
        """With edges `half` (n,) below and above y."""
        return cls(label, x, y, mark, y - half, y + half, names=names)


@dataclass(frozen=True)
class Plot:
    """One set of axes. `caption` says what the reader should see in it."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    caption: str = ""
    equal: bool = False  # one scale on both axes (board drawings, maps)
    log_y: bool = False
    bare: bool = False  # no ticks: a map, whose coordinates mean nothing


Block = Text | Facts | Table | Plot


@dataclass(frozen=True)
class Section:
    """A heading and its blocks. Of a page on a terminal those that fit are printed, and `kept` ones
    before all others."""

    title: str
    blocks: tuple[Block, ...]
    kept: bool = False


@dataclass(frozen=True)
class Worth:
    """What a sensor is good to in one quantity: "inclination", "± 0.21 deg", and on what data or
    at which attitude; more : what a first screen has no room for."""

    quantity: str
    value: str
    detail: str
    more: str = ""

    @property
    def whole(self) -> str:
        """All that is said of the value."""
        return "; ".join(filter(None, (self.detail, self.more)))


@dataclass(frozen=True)
class Use:
    """A command that a calibration is good for. words : its arguments, in which {calibration},
    {folder}, {input} and {suffix} stand for what the run wrote and read; after {input} stands what
    was typed of its reading"""

    purpose: str
    words: tuple[str, ...]

    def step(self, places: Mapping[str, str]) -> str:
        """The command as it is typed, with its purpose."""
        words = ["imucal"]
        for word in self.words:
            words.append(word.format(**places))
            words += shlex.split(places["reading"]) if word == "{input}" else []
        return f"{self.purpose}: `{paste(*words)}`"


@dataclass(frozen=True)
class Card:
    """What a reader takes away: the sensor's worth, what was found, what to do, the command.

    uses : what the calibration is good for, until it is known where it was written
    picture : the residual before and after what was found, where there is one
    """

    good_to: tuple[Worth, ...]
    found: tuple[Text, ...]
    to_do: tuple[str, ...]
    command: str = ""
    uses: tuple[Use, ...] = ()
    picture: Plot | None = None


@dataclass(frozen=True)
class Document:
    """A whole report: title, verdict with its tone, the card, sections that hold anything,
    provenance.

    certificate : what a calibration states of one instrument, for print alone; such a page also
        says what its words mean
    drawn : where the figures are, for a terminal
    """

    title: str
    verdict: Text
    sections: tuple[Section, ...]
    footer: tuple[tuple[str, str], ...] = ()
    card: Card | None = None
    certificate: Section | None = None
    drawn: str = "report.html"

    def __post_init__(self) -> None:
        object.__setattr__(self, "sections", tuple(s for s in self.sections if s.blocks))

    @property
    def plots(self) -> tuple[tuple[str, Plot], ...]:
        """Every plot with the title of its section; the card's picture first, as one of those."""
        own = [(s.title, b) for s in self.sections for b in s.blocks if isinstance(b, Plot)]
        picture = self.card.picture if self.card else None
        return (*([(RESIDUALS, picture)] if picture else []), *own)

    def place_commands(self, places: Mapping[str, str]) -> Document:
        """The same, with the commands that use what was written. places : see `Use`"""
        used = tuple(use.step(places) for use in self.card.uses) if self.card else ()
        return self._add_steps(used, f"{places['folder']}/{self.drawn}")

    def propose_writing(self, command: str) -> Document:
        """The same of a run that wrote nothing, with the command that writes it."""
        keep = (f"{KEEP}: `{command}`",) if self.card and self.card.uses else ()
        return self._add_steps(keep, "")

    def _add_steps(self, steps: tuple[str, ...], drawn: str) -> Document:
        """With more steps: first of a result that passes, else after the most useful one."""
        card, at = self.card, 0 if self.verdict.tone == "ok" else 1
        if card is not None:
            card = replace(card, to_do=(*card.to_do[:at], *steps, *card.to_do[at:]), uses=())
        return replace(self, card=card, drawn=drawn)

    def soften_tones(self) -> Document:
        """The same, without a tick next to a verdict that is none, and without a caution on the
        card of a result that passes: what stays then is within what the user accepts."""
        calm = self.verdict.tone not in ("warning", "bad")
        loud = "warning" if calm else "ok"
        card = self.card and replace(
            self.card, found=tuple(t if t.tone != loud else Text(t.text) for t in self.card.found)
        )
        if calm:
            return replace(self, card=card)
        sections = tuple(replace(s, blocks=tuple(map(_untick, s.blocks))) for s in self.sections)
        return replace(self, sections=sections, card=card)


def _untick(block: Block) -> Block:
    if isinstance(block, Text) and block.tone == "ok":
        return Text(block.text)
    if isinstance(block, Table) and "ok" in block.tones.values():
        return replace(block, tones={k: t for k, t in block.tones.items() if t != "ok"})
    return block
