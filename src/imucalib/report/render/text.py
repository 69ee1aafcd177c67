"""A report on one page of a terminal: verdict and card first, then what fits; no line too wide."""

from __future__ import annotations

import re
import shlex
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO

from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.table import Table as Grid
from rich.text import Text as Line

from imucalib.report.render.document import (
    Card,
    Document,
    Facts,
    Plot,
    Section,
    Table,
    Text,
    Tone,
    capital,
)
from imucalib.report.render.table import grids
from imucalib.report.render.terminal import SIGNS, STYLES, one_line, safe

NARROWEST = 40
MEASURE = 100  # longest line of running text
PAGE = 60  # lines of a report
SCREEN = 25  # lines of a calibration's first screen
_MOST, _FEWEST = 4, 2  # lines of one thing on it
_WHOLE = 10_000  # lines of one thing where nothing is cut
_UNFOLDED = 100_000  # cells
LEAST = 3  # rows of a table that stay, however little room there is
WORDS: dict[Tone, str] = {"ok": "PASSED", "warning": "CAUTION", "bad": "FAILED", "plain": ""}
#: Between two sentences.
_SENTENCE = re.compile(r"(?<=[.)]) (?=[A-Z])")
#: A command within a text, to the first backtick that is in no quotes.
_COMMAND = re.compile(r"""`(imucal (?:[^`'"]|'[^']*'|"[^"]*")+)`""")
#: Stands for a blank at which no line ends, until it is printed.
_HELD = "\ue000"
#: An option and its value in a shell's quotes, which a line break within would change.
_QUOTED = re.compile(r"""--[a-z-]+[ =](?:'[^']*'|"[^"]*")+""")


def render_text(document: Document, width: int, *, color: bool, full: bool = False) -> str:
    """What a reader needs first; no line is wider than `width` cells (at least 40).

    Of a document with a card a first screen: what it is good to, what was found, what to do; of
    another one page: its head and the sections that fit, without plots.
    color : ANSI colours; without them every tone still shows as a sign and a word
    full : every section, however long, without its plots
    """
    return _Sheet(document.soften_tones(), max(width, NARROWEST), color).compose(full)


class _Sheet:
    """A document on a terminal of some width."""

    def __init__(self, document: Document, width: int, color: bool) -> None:
        self.document, self.width, self.measure = document, width, min(width, MEASURE)
        self.out = StringIO()
        self.console = Console(
            file=self.out,
            width=width,
            force_terminal=color,
            color_system="standard" if color else None,
            no_color=not color,
            legacy_windows=False,
            highlight=False,
            markup=False,
            emoji=False,
            _environ={},
        )

    def compose(self, full: bool) -> str:
        """The page, or all of it."""
        document = self.document
        if document.card and not full:
            return self.put(self.screen(document.card))
        titles = [s.title for s in document.sections]
        drawn = {s.title for s in document.sections if not _has_words(s)}
        sections = [s for s in document.sections if _has_words(s)]
        lines = self.lines(*self.head())
        if document.card:
            lines += self.put_lists(self.lay_out_card(document.card, _WHOLE))
        if not full:
            foot = self.lines(*self.foot(titles, full=False))
            sections = self.select_fitting(sections, PAGE - len(lines) - len(foot))
        hidden = [title for title in titles if title not in {s.title for s in sections}]
        last = self.foot(hidden, full=full or set(hidden) <= drawn)
        shown = (part for section in sections for part in self.section(section))
        return self.put(lines + self.lines(*shown, *last))

    def put(self, lines: Sequence[Line]) -> str:
        """Lines as text."""
        for line in lines:
            self.console.print(line, no_wrap=True, overflow="ignore", crop=False)
        return self.out.getvalue().replace(_HELD, " ")

    def lines(self, *parts: RenderableType) -> list[Line]:
        """What parts come to on this terminal, without blanks at the ends of lines."""
        # Every part has its width; what is wider is a path that only the terminal may fold.
        options = self.console.options.update_width(_UNFOLDED)
        made = self.console.render_lines(Group(*parts), options, pad=False) if parts else []
        lines = [Line.assemble(*((s.text, s.style or "") for s in row)) for row in made]
        for line in lines:
            line.rstrip()
        return lines

    def length(self, sections: Sequence[Section]) -> int:
        """Lines of some sections; of more rows than a page has, their number is enough."""
        rows = sum(len(b.rows) for s in sections for b in s.blocks if isinstance(b, Table))
        if rows > PAGE:
            return rows
        return len(self.lines(*(part for s in sections for part in self.section(s))))

    def select_fitting(self, sections: Sequence[Section], room: int) -> list[Section]:
        """What is kept, shortened to the room, and what else fits into `room` lines, in order."""
        kept = self.shorten([s for s in sections if s.kept], room)
        room -= self.length(kept)
        rest, shown = iter(kept), []
        for section in sections:
            if section.kept:
                shown.append(next(rest))
            elif (length := self.length([section])) <= room:
                shown.append(section)
                room -= length
        return shown

    def shorten(self, sections: Sequence[Section], room: int) -> list[Section]:
        """The sections with as many rows of each table as fit into `room` lines together."""
        rows = [len(b.rows) for s in sections for b in s.blocks if isinstance(b, Table)]
        counts = range(LEAST, max([LEAST, *rows]) + 1)

        def cut(count: int) -> list[Section]:
            return [_cut_tables(section, count) for section in sections]

        fitting = bisect_right(counts, room, key=lambda count: self.length(cut(count)))
        return cut(counts[max(fitting - 1, 0)])

    def screen(self, card: Card) -> list[Line]:
        """The card alone, in `SCREEN` lines of 80 columns: all of it is said shorter before any of
        it goes, the last step first."""
        for most in range(_MOST, _FEWEST - 1, -1):
            lists = self.lay_out_card(card, most)
            verdict = self.cut(self.document.verdict.text, most - 1, 10)
            head = self.lines(*self.head(verdict))
            room = SCREEN - len(head) - 2 * len(lists) - len(self.last(PAGE))
            if sum(map(_height, lists.values())) <= room:
                break
        kept = {name: list(items) for name, items in lists.items()}
        for items in reversed(kept.values()):  # what it is good to goes last
            while len(items) > 1 and sum(map(_height, kept.values())) > room:
                items.pop()
        cut = sum(len(items) - len(kept[name]) for name, items in lists.items())
        return head + self.put_lists(kept) + self.last(cut)

    def put_lists(self, lists: dict[str, list[list[Line]]]) -> list[Line]:
        """Things, by the headings that they stand under."""
        lines: list[Line] = []
        for name, items in lists.items():
            lines += self.lines(*self.heading(name))
            lines += [line for item in items for line in item]
        return lines

    def last(self, cut: int) -> list[Line]:
        """Where the rest is, with how many things had no room."""
        where = f"--full{f', or {self.document.drawn}' if self.document.drawn else ''}"
        more = f"{cut} more, and the details" if cut else "The details"
        return self.lines(Line(), self.fold(Line(f"{more}: {where}", "dim")))

    def lay_out_card(self, card: Card, most: int) -> dict[str, list[list[Line]]]:
        """What a card says as lines of each thing, none of more than `most` but for commands."""
        widest = max((cell_len(one_line(w.quantity)) for w in card.good_to), default=0)
        lead, worths = min(widest, self.measure // 3), []
        for worth in card.good_to:
            said = f"{worth.value} ({worth.whole if most == _WHOLE else worth.detail})"
            row = (one_line(worth.quantity), _hold_options(one_line(said)))
            worths.append(self.lines(self.list_rows([row], lead, 2, "dim", "")))
        found = [
            self.lines(self.paragraph(replace(text, text=self.cut(text.text, most, 2))))
            for text in card.found
        ]
        steps = [
            self.step(k, step, most)
            for k, step in enumerate(card.to_do or ("Nothing to do.",), start=1)
        ]
        whole = {"Good to": worths, "Found": found, "What to do next": steps}
        return {name: items for name, items in whole.items() if items}

    def step(self, number: int, text: str, most: int) -> list[Line]:
        """One step; a command that does not fit beside its purpose on lines of its own."""
        if typed := self.lay_out_command(text, f"{number}.", 2):
            return self.lines(*typed)
        said = self.cut(_normalize_spaces(text).replace("`", ""), most, 3)
        return self.lines(self.list_rows([(f"{number}.", said)], 2, 1, "", ""))

    def lay_out_command(
        self, text: str, lead: str, width: int, style: str = ""
    ) -> list[RenderableType]:
        """What is said of a command, and the command ready to be pasted: never cut within a word,
        however long a path is; none where it fits on the line, or there is not one command."""
        whole = _normalize_spaces(text)
        parts = _COMMAND.split(whole)
        if len(parts) != 3 or cell_len(whole) - 2 <= self.measure - width - 1:
            return []
        before, after = parts[0].rstrip(" :"), parts[2].strip(" .")
        said = f"{before}. {capital(after)}." if before and after else before + ":"
        said = said if before else f"{capital(after.lstrip(': '))}:"
        lines = _continue_lines(parts[1], self.measure - width - 1)
        blank = " " * (width + 1)
        return [
            self.list_rows([(lead, said)], width, 1, style, style),
            *(Line(blank + line, no_wrap=True, overflow="ignore") for line in lines),
        ]

    def cut(self, text: str, most: int, lead: int) -> str:
        """The first sentences, as many as `most` lines hold behind `lead` cells; at least one."""
        said = _SENTENCE.split(_normalize_spaces(text))
        width = self.measure - lead
        while len(said) > 1 and -(-cell_len(" ".join(said)) // width) > most:
            said.pop()
        return " ".join(said)

    def head(self, words: str = "") -> list[RenderableType]:
        """Title and verdict, or its first words."""
        verdict = self.document.verdict
        mark = f"{SIGNS[verdict.tone]} {WORDS[verdict.tone]}: " if SIGNS[verdict.tone] else ""
        said = Line(mark + _normalize_spaces(words or verdict.text))
        said.stylize(f"bold {STYLES[verdict.tone]}".strip(), 0, len(mark))
        title = self.fold(Line(one_line(self.document.title), "bold"))
        return [title, Line("═" * self.measure, "dim"), self.fold(said)]

    def section(self, section: Section) -> list[RenderableType]:
        """Its heading, and its blocks with an empty line between them."""
        parts = self.heading(section.title)
        blocks = [block for block in section.blocks if not isinstance(block, Plot)]
        for i, block in enumerate(blocks):
            if i and not (isinstance(block, Text) and isinstance(blocks[i - 1], Text)):
                parts.append(Line())
            match block:
                case Text():
                    parts.append(self.paragraph(block))
                case Facts():
                    parts.append(self.facts(block.rows))
                case Table():
                    title, note = (
                        Line(one_line(block.title), "bold"),
                        Line(one_line(block.note), "dim"),
                    )
                    parts += [self.fold(title)] if title else []
                    parts += grids(block, self.width)
                    parts += [self.fold(note)] if note else []
        return parts

    def heading(self, title: str) -> list[RenderableType]:
        """A title in a rule, after an empty line."""
        name = Line(one_line(title), "bold")
        name.truncate(self.measure - 4, overflow="ellipsis")
        rule = "─" * (self.measure - cell_len(name.plain) - 1)
        return [Line(), Line.assemble(name, " ", (rule, "dim"))]

    def fold(self, text: Line) -> RenderableType:
        """Words folded to the measure."""
        grid = Grid.grid()
        grid.add_column(width=self.measure, overflow="fold")
        grid.add_row(text)
        return grid

    def paragraph(self, text: Text) -> RenderableType:
        """With its sign where it has a tone."""
        words, style = _normalize_spaces(text.text), STYLES[text.tone]
        if typed := self.lay_out_command(words, SIGNS[text.tone], 1, style):
            return Group(*typed)
        if not SIGNS[text.tone]:
            return self.fold(Line(words, style))
        return self.list_rows([(SIGNS[text.tone], words)], 1, 1, style, style)

    def facts(self, rows: Sequence[tuple[str, str]], style: str = "") -> RenderableType:
        """Names in one column, values folded in the next."""
        named = [(one_line(name), _hold_options(one_line(value))) for name, value in rows]
        widest = max((cell_len(name) for name, _ in named), default=0)
        return self.list_rows(named, min(widest, self.measure // 3), 2, "dim", style)

    def list_rows(
        self, rows: Sequence[tuple[str, str]], lead: int, gap: int, lead_style: str, style: str
    ) -> RenderableType:
        """Short leads in a column of `lead` cells, texts folded `gap` cells to the right."""
        grid = Grid.grid(padding=(0, gap, 0, 0))
        grid.add_column(width=lead, no_wrap=True, overflow="ellipsis", style=lead_style)
        grid.add_column(width=self.measure - lead - gap, style=style, overflow="fold")
        for name, text in rows:
            grid.add_row(Line(name), Line(text))
        return grid

    def foot(self, hidden: Sequence[str], *, full: bool) -> list[RenderableType]:
        """The footer, and what is not shown."""
        document, rows = self.document, [*self.document.footer]
        if hidden:
            drawn = f"{document.drawn} draws {'it' if len(hidden) == 1 else 'them'}"
            titles = ", ".join(map(one_line, hidden))
            rows.append(("Not shown here", f"{titles}; {drawn if full else '--full shows all'}"))
        if not rows:
            return []
        return [Line(), Line("─" * self.measure, "dim"), self.facts(rows, "dim")]


def _height(items: Sequence[Sequence[Line]]) -> int:
    return sum(map(len, items))


def _continue_lines(command: str, width: int) -> list[str]:
    """A command in lines of at most `width` cells that a shell takes as one."""
    lines = [""]
    for word in map(shlex.quote, shlex.split(command)):
        if lines[-1] and cell_len(f"{lines[-1]} {word} \\") > width:
            lines[-1] += " \\"
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _has_words(section: Section) -> bool:
    """Whether anything of it is words."""
    return any(not isinstance(block, Plot) for block in section.blocks)


def _normalize_spaces(text: str) -> str:
    """Paragraphs a line each, with single blanks between words."""
    lines = (" ".join(line.split()) for line in safe(text).splitlines())
    return _hold_options("\n".join(filter(None, lines)))


def _hold_options(text: str) -> str:
    """The text, in which no line ends within an option that is to be typed."""
    return _QUOTED.sub(lambda found: found[0].replace(" ", _HELD), text)


def _cut_tables(section: Section, rows: int) -> Section:
    """The section with at most `rows` rows of each table."""
    blocks = (_first(b, rows) if isinstance(b, Table) else b for b in section.blocks)
    return replace(section, blocks=tuple(blocks))


def _first(table: Table, rows: int) -> Table:
    """The toned rows and the first of the others, in their order."""
    every = range(len(table.rows))
    if len(every) <= rows:
        return table
    calm = [table.tones.get(i, "plain") not in ("bad", "warning") for i in every]
    kept = sorted(sorted(every, key=calm.__getitem__)[:rows])
    return replace(
        table,
        rows=tuple(table.rows[i] for i in kept),
        tones={n: table.tones[i] for n, i in enumerate(kept) if i in table.tones},
        note=f"{len(every) - rows} more rows: --full. {table.note}".rstrip(),
    )
