"""Messages of a block decoded into columns: ROS by compiled layouts, JSON and protobuf by parsing.

A path is the names of fields joined by dots; a number is a place in a list.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from imucalib.errors import UsageError
from imucalib.readers.messages.layout import (
    Definition,
    Groups,
    LayoutError,
    MessageLayout,
    definition_of,
)
from imucalib.readers.messages.records import MessageBlock, RecordRows, Topic

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_INFLATED = 1 << 26  # bytes of one message: no sensor reading is larger
_MOST_LAYOUTS = 16  # that are find_memory for each definition
#: In a path, what stands for each element of a list of objects.
EACH = "[]"
_UNREADABLE = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)
_DEEPEST, _MOST_FIELDS = 12, 1000
_DEEPEST_UNSET = 4  # of a protobuf's fields that the message does not have
#: Payloads to trees, None for one that cannot be parsed.
Parse = Callable[[Sequence[bytes]], list[Any]]


class Decoded(NamedTuple):
    """columns : (n, k) for each group, in the file's numeric types; good : (n,) decoded at all.

    rows : (n,) message of each sample, where messages hold lists of them; else None
    """

    columns: list[NDArray[Any]]
    good: NDArray[np.bool_]
    problem: str = ""
    rows: NDArray[np.int64] | None = None


class Look(NamedTuple):
    """What one message holds, by path: how many numbers, and texts."""

    leaves: dict[str, int]
    texts: dict[str, str]


class Decoder(ABC):
    """Decodes the messages of one schema."""

    @abstractmethod
    def look(self, payload: bytes) -> Look:
        """What one message holds; raises LayoutError."""

    @abstractmethod
    def decode(self, block: MessageBlock, groups: Groups) -> Decoded:
        """The values of the groups in every message of the block."""


def decoder_for(topic: Topic) -> Decoder:
    """The decoder of a topic's encoding; raises LayoutError when there is none."""
    encoding, schema = topic.encoding, topic.schema
    if encoding == "json":
        return TreeDecoder(_json_trees)
    if encoding not in ("cdr", "ros1", "protobuf"):
        raise LayoutError(f"the message encoding '{encoding}' is not supported")
    if encoding == "protobuf":
        return TreeDecoder(_protobuf_parser(schema))
    if schema is None:
        raise LayoutError("it has no schema")
    kind = "ros1msg" if encoding == "ros1" else schema.encoding
    return RosDecoder(definition_of(schema.name, kind, schema.data.decode("utf-8", "replace")))


@dataclass
class LayoutFamily:
    """Layouts that differ in the lengths they expect, but have the wanted fields in one place.

    dtype, names : of a message's fields, and those of each group, by `Layout.pick`
    """

    layout: MessageLayout
    dtype: np.dtype[np.void]
    names: list[list[str]]
    guards: list[list[tuple[int, int]]]

    def runs(self) -> list[tuple[int, str]] | None:
        """Offset and byte order of each group, where all are one run of doubles."""
        if any(len(names) != 1 for names in self.names):
            return None
        fields = [self.dtype.fields[names[0]] for names in self.names if self.dtype.fields]
        if any((kind.base.kind, kind.base.itemsize) != ("f", 8) for kind, *_ in fields):
            return None
        return [(offset, self.layout.order) for _, offset, *_ in fields]

    def fitting(
        self, block: MessageBlock, rows: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], RecordRows]:
        """The messages among `rows` that it fits, the others, and the fields of the former."""
        lengths, end = block.lengths[rows], self.layout.end
        fits = (lengths >= end) & (lengths <= end + self.layout.slack)
        some = rows[fits]
        fields = RecordRows(block.data, block.starts[some], self.dtype)
        agrees = self._agrees(fields, some.size)
        if not agrees.all():
            fits[fits] = agrees
            some = rows[fits]
            fields = RecordRows(block.data, block.starts[some], self.dtype)
        return some, rows[~fits], fields

    def _agrees(self, fields: RecordRows, count: int) -> NDArray[np.bool_]:
        found = {at: fields[f"guard{at}"] for at, _ in self.layout.guards}
        agrees = np.zeros(count, dtype=np.bool_)
        for guards in self.guards:
            one = np.ones(count, dtype=np.bool_)
            for at, value in guards:
                one &= found[at] == value
            agrees |= one
        if self.layout.head:
            agrees &= fields["head"] == np.void(self.layout.head)
        return agrees


class RosDecoder(Decoder):
    """ROS 1 and ROS 2 messages. Compiled layouts are kept and tried on each block first."""

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self._families: dict[Groups, list[LayoutFamily]] = {}

    def look(self, payload: bytes) -> Look:
        if payload.startswith(_ZSTD_MAGIC):
            payload = _inflate(payload)
        layout = MessageLayout(self._definition, payload)
        return Look({path: count for path, (*_, count) in layout.fields.items()}, layout.texts)

    def decode(self, block: MessageBlock, groups: Groups) -> Decoded:
        size = block.starts.size
        out, problems = _Columns(size, groups), list[str]()
        for rows, family, fields in self.fitting(block, groups, problems):
            parts = [[fields[name] for name in names] for names in family.names]
            out.put(rows, [p[0] if len(p) == 1 else np.hstack(p) for p in parts])
        packed = [
            row
            for row in np.flatnonzero(~out.good).tolist()
            if block.payload(row).startswith(_ZSTD_MAGIC)
        ]
        if packed:
            inner = self.decode(_unpack(block.take(np.array(packed))), groups)
            out.put(np.array(packed), inner.columns)
            out.good[packed] = inner.good
            problems.append(inner.problem)
        return Decoded(out.whole(), out.good, problems[-1] if problems else "")

    def fitting(
        self, block: MessageBlock, groups: Groups, problems: list[str]
    ) -> Iterator[tuple[NDArray[np.int64], LayoutFamily, RecordRows]]:
        """The messages that have the groups, with their fields; one family after the other.

        problems : gets a sentence for each of the others
        """
        todo = np.arange(block.starts.size)
        families = self._families.setdefault(groups, [])
        for family in tuple(families):
            rows, todo, fields = family.fitting(block, todo)
            if rows.size:
                yield rows, family, fields
            if not todo.size:
                return
        while todo.size:
            try:
                layout = MessageLayout(self._definition, block.payload(int(todo[0])))
                family = _admit(families, layout, groups)
            except LayoutError as error:
                problems.append(str(error))
                todo = todo[1:]
                continue
            rows, todo, fields = family.fitting(block, todo)
            yield rows, family, fields


def _admit(families: list[LayoutFamily], layout: MessageLayout, groups: Groups) -> LayoutFamily:
    """The family of a new layout; a new one comes to the front of the list."""
    dtype, names = layout.pick(groups)
    for family in families:
        same = (family.layout.head, family.layout.slack) == (layout.head, layout.slack)
        if same and family.dtype == dtype and len(family.guards) < _MOST_LAYOUTS:
            family.guards.append(layout.guards)
            return family
    families.insert(0, LayoutFamily(layout, dtype, names, [layout.guards]))
    del families[_MOST_LAYOUTS:]
    return families[0]


class _Columns:
    """The columns of one block while its messages are decoded in any order."""

    def __init__(self, size: int, groups: Groups) -> None:
        self._size, self._groups = size, groups
        self._columns: list[NDArray[Any]] = []
        self.good = np.zeros(size, dtype=np.bool_)

    def put(self, rows: NDArray[np.int64], columns: list[NDArray[Any]]) -> None:
        """The values of all groups in some messages."""
        self.good[rows] = True
        if rows.size == self._size:
            self._columns = columns
            return
        if not self._columns:
            shapes = [((self._size, c.shape[1]), c.dtype.newbyteorder("=")) for c in columns]
            self._columns = [np.zeros(*shape) for shape in shapes]
        for column, values in zip(self._columns, columns, strict=True):
            column[rows] = values

    def whole(self) -> list[NDArray[Any]]:
        """(n, k) for each group; zero where nothing was put."""
        return self._columns or [np.zeros((self._size, group.width)) for group in self._groups]


def _inflate(payload: bytes) -> bytes:
    """A zstd-compressed payload, unpacked; raises LayoutError."""
    import zstandard

    try:
        if zstandard.frame_content_size(payload) > _MOST_INFLATED:
            raise LayoutError("a compressed message is larger than any sensor's")
        data = zstandard.ZstdDecompressor().decompress(payload, max_output_size=_MOST_INFLATED)
    except (zstandard.ZstdError, MemoryError) as error:
        raise LayoutError("a compressed message is damaged") from error
    if data.startswith(_ZSTD_MAGIC):
        raise LayoutError("a message is compressed twice")
    return data


def _unpack(block: MessageBlock) -> MessageBlock:
    """A block of zstd-compressed payloads, unpacked; a damaged one becomes empty."""
    pieces = []
    for payload in block.payloads():
        try:
            pieces.append(_inflate(payload))
        except LayoutError:
            pieces.append(b"")
    lengths = np.array([len(p) for p in pieces], dtype=np.int64)
    return MessageBlock(b"".join(pieces), np.cumsum(lengths) - lengths, lengths)


class TreeDecoder(Decoder):
    """Messages that are parsed into trees of objects, lists and numbers."""

    def __init__(self, parse: Parse) -> None:
        self._parse = parse

    def look(self, payload: bytes) -> Look:
        (tree,) = self._parse([payload])
        if tree is None:
            raise LayoutError("a message cannot be parsed")
        found = Look({}, {})
        _descend(tree, "", found, 0)
        return found

    def decode(self, block: MessageBlock, groups: Groups) -> Decoded:
        trees, rows = self._parse(block.payloads()), None
        if any(EACH in path for group in groups for path in group.paths):
            trees, rows = _elements(trees, groups)
            groups = tuple(g._replace(paths=tuple(map(_within, g.paths))) for g in groups)
        return self._decode(trees, groups)._replace(rows=rows)

    def _decode(self, trees: list[Any], groups: Groups) -> Decoded:
        good = np.array([tree is not None for tree in trees], dtype=np.bool_)
        try:
            return Decoded(_columns(trees, groups), good)
        except _UNREADABLE:
            # One message spoils the block: find it, and decode the others.
            good = np.array([_readable(tree, groups) for tree in trees], dtype=np.bool_)
        out, kept = _Columns(len(trees), groups), np.flatnonzero(good)
        if kept.size:
            out.put(kept, _columns([trees[row] for row in kept.tolist()], groups))
        return Decoded(out.whole(), good, "not parsable, or a field is missing or no number")


class _Element(NamedTuple):
    """One element of a list of objects, and the message that holds it."""

    message: Any
    element: Any


def _within(path: str) -> str:
    """A path of the message as one of an `_Element`."""
    _, each, rest = path.partition(f".{EACH}.")
    return f"element.{rest}" if each else f"message.{path}"


def _elements(trees: list[Any], groups: Groups) -> tuple[list[Any], NDArray[np.int64]]:
    """Every element of the list that the groups name, and the message of each; a message without
    the list is one that cannot be read. Raises LayoutError for two lists."""
    paths = [path for group in groups for path in group.paths if EACH in path]
    lists = {path.partition(f".{EACH}.")[0] for path in paths}
    if len(lists) > 1 or any(path.count(EACH) > 1 for path in paths):
        raise LayoutError(f"its samples lie in {len(lists)} lists")
    keys, found, rows = lists.pop().split("."), list[Any](), list[int]()
    for row, tree in enumerate(trees):
        held = tree
        try:
            for key in keys:
                held = _child(held, key)
            each: list[Any] = [_Element(tree, element) for element in held]
        except _UNREADABLE:
            each = [None]
        found += each
        rows += [row] * len(each)
    return found, np.array(rows, dtype=np.int64)


def _columns(trees: list[Any], groups: Groups) -> list[NDArray[Any]]:
    reached: dict[tuple[str, ...], list[Any]] = {(): trees}
    columns = []
    for group in groups:
        column = np.hstack([_numbers(_at(p.split("."), reached)) for p in group.paths])
        if column.shape[1] != group.width:
            raise ValueError("a field has another number of elements")
        columns.append(column)
    return columns


def _readable(tree: Any, groups: Groups) -> bool:
    try:
        _columns([tree], groups)
    except _UNREADABLE:
        return False
    return True


def _at(keys: Sequence[str], reached: dict[tuple[str, ...], list[Any]]) -> list[Any]:
    """What lies at a path in every tree; `reached` is filled with what lies on the way."""
    path = tuple(keys)
    if path not in reached:
        reached[path] = [_child(tree, keys[-1]) for tree in _at(keys[:-1], reached)]
    return reached[path]


def _child(tree: Any, key: str) -> Any:
    if isinstance(tree, dict):
        return tree[key]
    if hasattr(tree, "DESCRIPTOR"):  # a message that is not set reads as zeros
        part = tree.DESCRIPTOR.fields_by_name[key]
        if part.has_presence and not tree.HasField(key):
            raise KeyError(key)
    return tree[int(key)] if key.isdigit() else getattr(tree, key)


def _numbers(values: list[Any]) -> NDArray[Any]:
    """(n, k) numbers; ISO 8601 text in UTC becomes int64 nanoseconds since 1970."""
    if values and isinstance(values[0], str):
        if not all(value.endswith(("Z", "+00:00")) for value in values):
            raise ValueError("a text time must be UTC and end in Z")
        texts = [value.removesuffix("Z").removesuffix("+00:00") for value in values]
        times = np.array(texts, dtype="datetime64[ns]")
        if np.isnat(times).any():
            raise ValueError("a text time is no date")
        return times.astype(np.int64)[:, None]
    array = np.array([v if isinstance(v, int | float) else tuple(v) for v in values])
    if array.dtype.kind not in "iuf":
        raise TypeError("not numbers")
    if array.dtype.kind != "f" and array.size and np.abs(array).max() < 2**53:
        array = array.astype(np.float64)  # exact, and the same type as a neighbour like 1.5
    return array[:, None] if array.ndim == 1 else array.reshape(len(values), -1)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _descend(tree: Any, path: str, found: Look, depth: int) -> None:
    """Note the numbers and texts below a place of a tree."""
    if depth > _DEEPEST or len(found.leaves) > _MOST_FIELDS:
        return
    if isinstance(tree, str):
        found.texts[path] = tree
    if path and (_is_number(tree) or isinstance(tree, str)):
        found.leaves[path] = 1
        return
    children = _children(tree, depth)
    if children and isinstance(children[0][0], int) and all(_is_number(v) for _, v in children):
        found.leaves[path] = len(children)
        return
    if children and isinstance(children[0][0], int) and _children(children[0][1], depth):
        children = [(EACH, children[0][1])]
    for key, value in children:
        _descend(value, f"{path}.{key}" if path else str(key), found, depth + 1)


def _children(tree: Any, depth: int) -> list[tuple[str | int, Any]]:
    """What an object or a list holds, by name or place."""
    if isinstance(tree, Mapping):
        return [(key, value) for key, value in tree.items() if "." not in str(key)]
    if hasattr(tree, "DESCRIPTOR"):  # what a type holds of itself only where the message has it
        kind = tree.DESCRIPTOR
        return [
            (part.name, getattr(tree, part.name))
            for part in kind.fields
            if part.message_type is None
            or (part.message_type is not kind and depth <= _DEEPEST_UNSET)
            or _is_set(tree, part.name)
        ]
    return list(enumerate(tree)) if isinstance(tree, Sequence) and not isinstance(tree, str) else []


def _is_set(message: Any, name: str) -> bool:
    return any(part.name == name for part, _ in message.ListFields())


def _json_trees(payloads: Sequence[bytes]) -> list[Any]:
    try:
        trees = json.loads(b"[" + b",".join(payloads) + b"]")
        # A payload like `{},{}` would shift its neighbours: the count gives it away.
        if len(trees) == len(payloads):
            return list(trees)
    except (ValueError, RecursionError):
        pass
    return [_json_tree(payload) for payload in payloads]


def _json_tree(payload: bytes) -> Any:
    try:
        return json.loads(payload)
    except (ValueError, RecursionError):
        return None


def _protobuf_parser(schema: Schema | None) -> Parse:
    """Messages of a FileDescriptorSet schema. Raises UsageError without the protobuf package."""
    try:
        from google.protobuf import (  # type: ignore[import-untyped, unused-ignore]
            descriptor_pb2,
            descriptor_pool,
            message,
            message_factory,
        )
    except ImportError as error:
        raise UsageError(
            "protobuf messages need the protobuf package",
            remedy="install it: pip install 'imucalib[protobuf]'",
        ) from error
    if schema is None:
        raise LayoutError("it has no schema")
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
        pool, waiting = descriptor_pool.DescriptorPool(), {file.name: file for file in files}
        while waiting:
            ready = [f for f in waiting.values() if not waiting.keys() & set(f.dependency)]
            if not ready:
                raise ValueError("the files depend on each other in a circle")
            for file in ready:
                pool.Add(waiting.pop(file.name))
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    except (message.DecodeError, KeyError, TypeError, ValueError) as error:
        raise LayoutError(f"its protobuf schema does not define {schema.name}") from error

    def parse(payload: bytes) -> Any:
        try:
            return kind.FromString(payload)
        except message.DecodeError:
            return None

    return lambda payloads: [parse(payload) for payload in payloads]
