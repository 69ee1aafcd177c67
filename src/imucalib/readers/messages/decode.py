"""Messages of a block decoded into columns: ROS by compiled layouts, JSON and protobuf by parsing.

Every decoder answers which numeric fields a message has (`leaves`), what their values are in all
messages of a block (`decode`), and what a string of one message says (`text`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.messages.columns import (
    ZSTD_MAGIC,
    Decoded,
    Filler,
    Rows,
    Widths,
    inflate,
    inflated,
)
from imucalib.readers.messages.definition import Definition, LayoutError, definition_of
from imucalib.readers.messages.layout import Groups, Layout, compile_layout
from imucalib.readers.messages.records import MessageBlock, Topic

_MOST_LAYOUTS = 16  # that are remembered for each definition


class Decoder(Protocol):
    """Decodes the messages of one schema."""

    def leaves(self, payload: bytes) -> dict[str, int]:
        """Path of every number in a message, with its element count; raises LayoutError."""
        ...

    def text(self, payload: bytes, path: str) -> str:
        """A string of a message, empty where it has none; raises LayoutError."""
        ...

    def decode(self, block: MessageBlock, groups: Groups, widths: Widths) -> Decoded:
        """The values of the groups, of known widths, in every message of the block."""
        ...


def decoder_for(topic: Topic) -> Decoder:
    """The decoder of a topic's encoding; raises LayoutError when there is none."""
    encoding, schema = topic.encoding, topic.schema
    if encoding in ("cdr", "ros1"):
        if schema is None:
            raise LayoutError("it has no schema")
        kind = "ros1msg" if encoding == "ros1" else schema.encoding
        return RosDecoder(definition_of(schema.name, kind, schema.data.decode("utf-8", "replace")))
    if encoding == "json":
        from imucalib.readers.messages.trees import json_decoder

        return json_decoder()
    if encoding == "protobuf":
        from imucalib.readers.messages.trees import protobuf_decoder

        return protobuf_decoder(schema)
    raise LayoutError(f"the message encoding '{encoding}' is not supported")


class RosDecoder:
    """ROS 1 and ROS 2 messages. Compiled layouts are kept and tried on each block first."""

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self._families: dict[Groups, list[_Family]] = {}

    def leaves(self, payload: bytes) -> dict[str, int]:
        return {path: count for path, (_, _, count) in self._layout(payload).fields.items()}

    def text(self, payload: bytes, path: str) -> str:
        return self._layout(payload).texts.get(path, "")

    def _layout(self, payload: bytes) -> Layout:
        if payload[:4] == ZSTD_MAGIC:
            payload = inflate(payload)
        return compile_layout(self._definition, payload)

    def decode(self, block: MessageBlock, groups: Groups, widths: Widths) -> Decoded:
        filler = Filler(block.starts.size, widths)
        todo = np.arange(block.starts.size)
        families = self._families.setdefault(groups, [])
        for family in tuple(families):
            todo = _apply(family, block, todo, filler)
            if todo.size == 0:
                return filler.decoded()
        while todo.size:
            first = int(todo[0])
            start, size = int(block.starts[first]), int(block.lengths[first])
            payload = block.data[start : start + size]
            try:
                if payload[:4] == ZSTD_MAGIC:
                    inner = inflated(block.take(todo))
                    filler.put(todo, self.decode(inner, groups, widths))
                    break
                layout = compile_layout(self._definition, payload)
                _check_widths(layout, groups, widths)
            except LayoutError as error:
                filler.problem = str(error)
                todo = todo[1:]
                continue
            todo = _apply(_admit(families, layout, groups), block, todo, filler)
        return filler.decoded()

    def located(
        self, block: MessageBlock, group: tuple[str, ...]
    ) -> Iterator[tuple[NDArray[np.int64], int, str]]:
        """Messages whose group is one run of doubles: rows, offset in the payload, byte order."""
        todo = np.arange(block.starts.size)
        for family in tuple(self._families.get((group,), [])):
            rows, todo, _ = _fitting(family, block, todo)
            yield rows, *_run(family)
        while todo.size:
            first = int(todo[0])
            start, size = int(block.starts[first]), int(block.lengths[first])
            try:
                layout = compile_layout(self._definition, block.data[start : start + size])
                _check_widths(layout, (group,), (len(group),))
            except LayoutError:
                todo = todo[1:]
                continue
            family = _admit(self._families.setdefault((group,), []), layout, (group,))
            rows, todo, _ = _fitting(family, block, todo)
            yield rows, *_run(family)


@dataclass
class _Family:
    """Layouts that differ in the lengths they expect, but have the wanted fields in one place."""

    layout: Layout
    dtype: np.dtype[np.void]
    names: list[list[str]]
    guards: list[tuple[tuple[int, int], ...]]


def _run(family: _Family) -> tuple[int, str]:
    """Offset and byte order of a family's only group; offset -1 when it is no run of doubles."""
    names = family.names[0]
    assert family.dtype.fields is not None
    kind, offset = family.dtype.fields[names[0]][:2]
    one_run = len(names) == 1 and kind.base.kind == "f" and kind.base.itemsize == 8
    return (offset if one_run else -1), family.layout.order


def _admit(families: list[_Family], layout: Layout, groups: Groups) -> _Family:
    """The family of a new layout, at the front of the list."""
    dtype, names = layout.pick(groups)
    for family in families:
        same = (family.layout.head, family.layout.slack) == (layout.head, layout.slack)
        if same and family.dtype == dtype and len(family.guards) < _MOST_LAYOUTS:
            family.guards.append(layout.guards)
            return family
    families.insert(0, _Family(layout, dtype, names, [layout.guards]))
    del families[_MOST_LAYOUTS:]
    return families[0]


def _fitting(
    family: _Family, block: MessageBlock, todo: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Rows | None]:
    """The messages among `todo` that the family fits, the rest, and the fields of the former."""
    whole = todo.size == block.starts.size
    lengths = block.lengths if whole else block.lengths[todo]
    end = family.layout.end
    fits = (lengths >= end) & (lengths <= end + family.layout.slack)
    rest = todo[:0]
    if not fits.all():
        todo, rest = todo[fits], todo[~fits]
        if todo.size == 0:
            return todo, rest, None
        whole = False
    rows = Rows(block.data, block.starts if whole else block.starts[todo], family.dtype)
    agrees = _agrees(family, rows)
    if not agrees.all():
        rest = np.sort(np.concatenate([rest, todo[~agrees]]))
        todo = todo[agrees]
        rows = Rows(block.data, block.starts[todo], family.dtype)
    return todo, rest, rows


def _apply(
    family: _Family, block: MessageBlock, todo: NDArray[np.int64], filler: Filler
) -> NDArray[np.int64]:
    """Decode what the family fits among `todo`; returns the rest."""
    todo, rest, rows = _fitting(family, block, todo)
    if rows is None:
        return rest
    for i, parts in enumerate(family.names):
        columns = [rows.vectors(name) for name in parts]
        filler.put_column(todo, i, columns[0] if len(columns) == 1 else np.hstack(columns))
    filler.good[todo] = True
    return rest


def _check_widths(layout: Layout, groups: Groups, widths: Widths) -> None:
    dtype, names = layout.pick(groups)
    for group, parts, width in zip(groups, names, widths, strict=True):
        found = sum(int(np.prod(dtype[name].shape)) for name in parts)
        if found != width:
            raise LayoutError(f"'{group[0]}' has {found} numbers instead of {width}")


def _agrees(family: _Family, rows: Rows) -> NDArray[np.bool_]:
    found = {at: rows.column(f"guard{at}") for at, _ in family.layout.guards}
    agrees: NDArray[np.bool_] | np.bool_ = np.False_
    for guards in family.guards:
        one: NDArray[np.bool_] | np.bool_ = np.True_
        for at, value in guards:
            one = one & (found[at] == value)
        agrees = agrees | one
    if family.layout.head:
        agrees = agrees & (rows.column("head") == np.void(family.layout.head))
    return np.broadcast_to(agrees, (rows.count,))
