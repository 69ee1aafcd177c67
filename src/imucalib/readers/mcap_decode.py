"""Messages of a block decoded into columns: ROS by compiled layouts, JSON and protobuf by parsing.

Every decoder answers two questions: which numeric fields does a message have (`leaves`), and
what are their values in all messages of a block (`decode`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.mcap_definition import Definition, LayoutError, definition_of
from imucalib.readers.mcap_layout import Groups, Layout, compile_layout
from imucalib.readers.mcap_records import MessageBlock, Topic

Widths = tuple[int, ...]  # numbers in each group
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_INFLATED = 1 << 26  # of one message: no sensor reading is larger
_MOST_LAYOUTS = 16  # that are remembered for each definition


@dataclass(frozen=True)
class Decoded:
    """columns : (n, k) for each group, in the file's numeric types; good : (n,) decoded at all."""

    columns: tuple[NDArray[Any], ...]
    good: NDArray[np.bool_]
    problem: str = ""


class Decoder(Protocol):
    """Decodes the messages of one schema."""

    def leaves(self, payload: bytes) -> dict[str, int]:
        """Path of every number in a message, with its element count; raises LayoutError."""
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
        from imucalib.readers.mcap_trees import json_decoder

        return json_decoder()
    if encoding == "protobuf":
        from imucalib.readers.mcap_trees import protobuf_decoder

        return protobuf_decoder(schema)
    raise LayoutError(f"the message encoding '{encoding}' is not supported")


class RosDecoder:
    """ROS 1 and ROS 2 messages. Compiled layouts are kept and tried on each block first."""

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self._families: dict[Groups, list[_Family]] = {}

    def leaves(self, payload: bytes) -> dict[str, int]:
        if payload[:4] == ZSTD_MAGIC:
            payload = _inflate(payload)
        layout = compile_layout(self._definition, payload)
        return {path: count for path, (_, _, count) in layout.fields.items()}

    def decode(self, block: MessageBlock, groups: Groups, widths: Widths) -> Decoded:
        filler = _Filler(block.starts.size, widths)
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
                    inner = _inflated(block.take(todo))
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


@dataclass
class _Family:
    """Layouts that differ in the lengths they expect, but have the wanted fields in one place."""

    layout: Layout
    dtype: np.dtype[np.void]
    names: list[list[str]]
    guards: list[tuple[tuple[int, int], ...]]


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


def _apply(
    family: _Family, block: MessageBlock, todo: NDArray[np.int64], filler: _Filler
) -> NDArray[np.int64]:
    """Decode what the family fits among `todo`; returns the rest."""
    whole = todo.size == block.starts.size
    lengths = block.lengths if whole else block.lengths[todo]
    end = family.layout.end
    fits = (lengths >= end) & (lengths <= end + family.layout.slack)
    rest = todo[:0]
    if not fits.all():
        todo, rest = todo[fits], todo[~fits]
        if todo.size == 0:
            return rest
        whole = False
    rows = _Rows(block.data, block.starts if whole else block.starts[todo], family.dtype)
    agrees = _agrees(family, rows)
    if not agrees.all():
        rest = np.sort(np.concatenate([rest, todo[~agrees]]))
        todo = todo[agrees]
        rows = _Rows(block.data, block.starts[todo], family.dtype)
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


class _Rows:
    """Record fields at given byte positions; an even spacing needs no gathering."""

    def __init__(self, data: bytes, starts: NDArray[np.int64], dtype: np.dtype[np.void]) -> None:
        self._starts: NDArray[np.int64] | None = starts
        self.count = starts.size
        steps = np.diff(starts)
        if starts.size > 1 and (steps == steps[0]).all() and steps[0] > 0:
            step = int(steps[0])
            self._view = np.ndarray((starts.size,), dtype, data, int(starts[0]), (step,))
            self._starts = None
        else:
            self._view = np.ndarray((len(data) - dtype.itemsize + 1,), dtype, data, 0, (1,))

    def column(self, name: str) -> NDArray[Any]:
        part = self._view[name]
        return part if self._starts is None else part[self._starts]

    def vectors(self, name: str) -> NDArray[Any]:
        """(n, k): a scalar field is one column."""
        part = self.column(name)
        return part[:, None] if part.ndim == 1 else part


def _agrees(family: _Family, rows: _Rows) -> NDArray[np.bool_]:
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


class _Filler:
    """Columns of one block while its messages are decoded in any order."""

    def __init__(self, size: int, widths: Widths) -> None:
        self.size, self._widths = size, widths
        self.columns: list[NDArray[Any] | None] = [None] * len(widths)
        self.good = np.zeros(size, dtype=np.bool_)
        self.problem = ""

    def put_column(self, rows: NDArray[np.int64], index: int, values: NDArray[Any]) -> None:
        current = self.columns[index]
        if current is None and rows.size == self.size:
            self.columns[index] = values
            return
        if current is None:
            current = np.zeros((self.size, values.shape[1]), dtype=values.dtype.newbyteorder("="))
        current[rows] = values
        self.columns[index] = current

    def put(self, rows: NDArray[np.int64], decoded: Decoded) -> None:
        for i, values in enumerate(decoded.columns):
            self.put_column(rows, i, values)
        self.good[rows] = decoded.good
        self.problem = self.problem or decoded.problem

    def decoded(self) -> Decoded:
        pairs = zip(self.columns, self._widths, strict=True)
        columns = tuple(np.zeros((self.size, w)) if c is None else c for c, w in pairs)
        return Decoded(columns, self.good, self.problem)


def _inflate(payload: bytes) -> bytes:
    import zstandard

    try:
        size = zstandard.frame_content_size(payload)
        if size > _MOST_INFLATED:
            raise LayoutError(f"a compressed message claims {size} bytes")
        data = zstandard.ZstdDecompressor().decompress(payload, max_output_size=_MOST_INFLATED)
    except (zstandard.ZstdError, MemoryError) as error:
        raise LayoutError("a compressed message is damaged") from error
    if data[:4] == ZSTD_MAGIC:
        raise LayoutError("a message is compressed twice")
    return bytes(data)


def _inflated(block: MessageBlock) -> MessageBlock:
    """The block with every zstd-compressed payload unpacked; a damaged one becomes empty."""
    pieces = []
    for payload in block.payloads():
        try:
            pieces.append(_inflate(payload) if payload[:4] == ZSTD_MAGIC else payload)
        except LayoutError:
            pieces.append(b"")
    lengths = np.array([len(p) for p in pieces], dtype=np.int64)
    return MessageBlock(b"".join(pieces), np.cumsum(lengths) - lengths, lengths, block.offset)
