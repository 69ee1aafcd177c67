"""Messages of a block decoded into columns: ROS by compiled layouts, JSON and protobuf by parsing.

Every decoder answers which numeric fields a message has (`leaves`), what their values are in all
messages of a block (`decode`), and what a string of one message says (`text`). A path is the field
names joined by dots; a number stands for a place in a list.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UsageError
from imucalib.readers.csv.stamps import MISSING, TextTime, text_to_ns
from imucalib.readers.messages.layout import (
    Definition,
    Groups,
    Layout,
    LayoutError,
    compile_layout,
    definition_of,
)
from imucalib.readers.messages.records import MessageBlock, Schema, Topic

Widths = tuple[int, ...]  # numbers in each group
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_INFLATED = 1 << 26  # of one message: no sensor reading is larger


@dataclass(frozen=True)
class Decoded:
    """columns : (n, k) for each group, in the file's numeric types; good : (n,) decoded at all."""

    columns: tuple[NDArray[Any], ...]
    good: NDArray[np.bool_]
    problem: str = ""


class Rows:
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
        """(n,) or (n, k) values of one field."""
        part = self._view[name]
        return part if self._starts is None else part[self._starts]

    def vectors(self, name: str) -> NDArray[Any]:
        """(n, k): a scalar field is one column."""
        part = self.column(name)
        return part[:, None] if part.ndim == 1 else part


class Filler:
    """Columns of one block while its messages are decoded in any order."""

    def __init__(self, size: int, widths: Widths) -> None:
        self.size, self._widths = size, widths
        self.columns: list[NDArray[Any] | None] = [None] * len(widths)
        self.good = np.zeros(size, dtype=np.bool_)
        self.problem = ""

    def put_column(self, rows: NDArray[np.int64], index: int, values: NDArray[Any]) -> None:
        """One group's values of some messages."""
        current = self.columns[index]
        if current is None and rows.size == self.size:
            self.columns[index] = values
            return
        if current is None:
            current = np.zeros((self.size, values.shape[1]), dtype=values.dtype.newbyteorder("="))
        current[rows] = values
        self.columns[index] = current

    def put(self, rows: NDArray[np.int64], decoded: Decoded) -> None:
        """All groups of some messages, decoded elsewhere."""
        for i, values in enumerate(decoded.columns):
            self.put_column(rows, i, values)
        self.good[rows] = decoded.good
        self.problem = self.problem or decoded.problem

    def decoded(self) -> Decoded:
        """All columns; what was never put is zero and not good."""
        pairs = zip(self.columns, self._widths, strict=True)
        columns = tuple(np.zeros((self.size, w)) if c is None else c for c, w in pairs)
        return Decoded(columns, self.good, self.problem)


def inflate(payload: bytes) -> bytes:
    """A zstd-compressed payload, unpacked; raises LayoutError."""
    from imucalib.readers import zstd

    try:
        data = zstd.first_frame(payload, _MOST_INFLATED)
    except (zstd.ZstdError, MemoryError) as error:
        raise LayoutError("a compressed message is damaged") from error
    if data[:4] == ZSTD_MAGIC:
        raise LayoutError("a message is compressed twice")
    return data


def inflated(block: MessageBlock) -> MessageBlock:
    """The block with every zstd-compressed payload unpacked; a damaged one becomes empty."""
    pieces = []
    for payload in block.payloads():
        try:
            pieces.append(inflate(payload) if payload[:4] == ZSTD_MAGIC else payload)
        except LayoutError:
            pieces.append(b"")
    lengths = np.array([len(p) for p in pieces], dtype=np.int64)
    return MessageBlock(b"".join(pieces), np.cumsum(lengths) - lengths, lengths, block.offset)


_UNREADABLE = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)
_DEEPEST, _MOST_FIELDS = 12, 1000
Parse = Callable[[Sequence[bytes]], list[Any]]


class TreeDecoder:
    """Messages that parse into trees.

    parse : payloads -> trees, None for one that cannot be parsed
    flatten : tree -> (path, count) of its numbers
    step : one step down a tree
    """

    def __init__(
        self,
        parse: Parse,
        flatten: Callable[[Any], dict[str, int]],
        step: Callable[[Any, str], Any],
    ) -> None:
        self._parse, self._flatten, self._step = parse, flatten, step

    def leaves(self, payload: bytes) -> dict[str, int]:
        return self._flatten(self._tree(payload))

    def text(self, payload: bytes, path: str) -> str:
        try:
            (value,) = self._walk(tuple(path.split(".")), {(): [self._tree(payload)]})
        except _UNREADABLE:
            return ""
        return value if isinstance(value, str) else ""

    def _tree(self, payload: bytes) -> Any:
        (tree,) = self._parse([payload])
        if tree is None:
            raise LayoutError("a message cannot be parsed")
        return tree

    def decode(self, block: MessageBlock, groups: Groups, widths: Widths) -> Decoded:
        trees = self._parse(block.payloads())
        good = np.array([tree is not None for tree in trees], dtype=np.bool_)
        try:
            return Decoded(self._columns(trees, groups, widths), good)
        except _UNREADABLE:
            # One message spoils the block: find it, and decode the others.
            good = np.array([self._readable(t, groups, widths) for t in trees], dtype=np.bool_)
        kept = [tree for tree, ok in zip(trees, good, strict=True) if ok]
        columns = tuple(np.zeros((len(trees), width)) for width in widths)
        if kept:
            columns = tuple(_spread(c, good) for c in self._columns(kept, groups, widths))
        return Decoded(columns, good, "not parsable, or a field is missing or no number")

    def _readable(self, tree: Any, groups: Groups, widths: Widths) -> bool:
        try:
            self._columns([tree], groups, widths)
        except _UNREADABLE:
            return False
        return True

    def _columns(
        self, trees: list[Any], groups: Groups, widths: Widths
    ) -> tuple[NDArray[Any], ...]:
        reached: dict[tuple[str, ...], list[Any]] = {(): trees}
        columns = []
        for group, width in zip(groups, widths, strict=True):
            parts = [_numbers(self._walk(tuple(path.split(".")), reached)) for path in group]
            columns.append(parts[0] if len(parts) == 1 else np.hstack(parts))
            if columns[-1].shape[1] != width:
                raise ValueError("a field has another number of elements")
        return tuple(columns)

    def _walk(self, keys: tuple[str, ...], reached: dict[tuple[str, ...], list[Any]]) -> list[Any]:
        if keys not in reached:
            step, key = self._step, keys[-1]
            reached[keys] = [step(tree, key) for tree in self._walk(keys[:-1], reached)]
        return reached[keys]


def _numbers(values: list[Any]) -> NDArray[Any]:
    """(n, k) numbers; ISO 8601 text becomes int64 nanoseconds since 1970."""
    if values and isinstance(values[0], str):
        if not all(value.endswith(("Z", "+00:00")) for value in values):
            raise ValueError("a text time must be UTC and end in Z")
        bare = (value.removesuffix("Z").removesuffix("+00:00") for value in values)
        texts = [value.replace("T", " ") for value in bare]
        ns, wrong = text_to_ns(np.array(texts, dtype=np.bytes_), TextTime("YMDhmsf", True))
        if wrong.any() or (ns == MISSING).any():
            raise ValueError(f"'{texts[int(np.argmax(wrong | (ns == MISSING)))]}' is no date")
        return ns[:, None]
    array = np.array([v if isinstance(v, int | float) else tuple(v) for v in values])
    if array.dtype.kind not in "iuf":
        raise TypeError("not numbers")
    if array.dtype.kind != "f" and array.size and np.abs(array).max() < 2**53:
        array = array.astype(np.float64)  # exact, and the same type as a neighbour like 1.5
    return array[:, None] if array.ndim == 1 else array.reshape(len(values), -1)


def _spread(values: NDArray[Any], good: NDArray[np.bool_]) -> NDArray[Any]:
    out = np.zeros((good.size, values.shape[1]), dtype=values.dtype)
    out[good] = values
    return out


# -- JSON -------------------------------------------------------------------------------------


def json_decoder() -> TreeDecoder:
    """JSON objects; msgspec parses them when it is installed, the standard library otherwise."""
    try:
        import msgspec  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        return TreeDecoder(_bulk(json.loads), _flatten_json, _json_step)
    return TreeDecoder(_bulk(msgspec.json.Decoder().decode), _flatten_json, _json_step)


def _bulk(loads: Callable[[bytes], Any]) -> Parse:
    def parse(payloads: Sequence[bytes]) -> list[Any]:
        try:
            trees = loads(b"[" + b",".join(payloads) + b"]")
            # A payload like `{},{}` would shift its neighbours: the count gives it away.
            if len(trees) == len(payloads):
                return list(trees)
        except (ValueError, RecursionError):
            pass
        return [_alone(loads, payload) for payload in payloads]

    return parse


def _alone(loads: Callable[[bytes], Any], payload: bytes) -> Any:
    try:
        return loads(payload)
    except (ValueError, RecursionError):
        return None


def _json_step(tree: Any, key: str) -> Any:
    return tree[int(key)] if isinstance(tree, list) else tree[key]


def _flatten_json(tree: Any) -> dict[str, int]:
    found: dict[str, int] = {}
    _descend(tree, "", found)
    return found


def _descend(tree: Any, path: str, found: dict[str, int], depth: int = 0) -> None:
    if depth > _DEEPEST or len(found) > _MOST_FIELDS:
        return
    prefix = f"{path}." if path else ""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if "." not in key:
                _descend(value, prefix + key, found, depth + 1)
    elif isinstance(tree, list):
        if tree and all(isinstance(v, int | float) and not isinstance(v, bool) for v in tree):
            found[path] = len(tree)
        else:
            for i, value in enumerate(tree):
                _descend(value, f"{prefix}{i}", found, depth + 1)
    elif isinstance(tree, int | float | str) and not isinstance(tree, bool) and path:
        found[path] = 1


# -- protobuf ---------------------------------------------------------------------------------


def protobuf_decoder(schema: Schema | None) -> TreeDecoder:
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
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
        pool = descriptor_pool.DescriptorPool()
        for file in _dependencies_first(list(files.file)):
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    except (message.DecodeError, KeyError, TypeError, ValueError) as error:
        raise LayoutError(f"its protobuf schema does not define {schema.name}") from error

    def parse(payloads: Sequence[bytes]) -> list[Any]:
        return [one(payload) for payload in payloads]

    def one(payload: bytes) -> Any:
        try:
            return kind.FromString(payload)
        except message.DecodeError:
            return None

    def flatten(tree: Any) -> dict[str, int]:
        found: dict[str, int] = {}
        _descend_protobuf(tree, "", found)
        return found

    return TreeDecoder(
        parse, flatten, lambda tree, key: tree[int(key)] if key.isdigit() else getattr(tree, key)
    )


def _dependencies_first(files: list[Any]) -> list[Any]:
    ordered: list[Any] = []
    names: set[str] = set()
    present = {file.name for file in files}
    while files:
        ready = [f for f in files if all(d in names or d not in present for d in f.dependency)]
        if not ready:
            raise ValueError("the files depend on each other in a circle")
        ordered += ready
        names |= {f.name for f in ready}
        files = [f for f in files if f.name not in names]
    return ordered


def _descend_protobuf(tree: Any, path: str, found: dict[str, int], depth: int = 0) -> None:
    prefix = f"{path}." if path else ""
    if len(found) > _MOST_FIELDS:
        raise LayoutError(f"it has more than {_MOST_FIELDS} fields")
    for part in tree.DESCRIPTOR.fields:
        value = getattr(tree, part.name)
        here = prefix + part.name
        if hasattr(value, "DESCRIPTOR"):
            # What a type holds of itself is left out unless the message has it.
            own = part.message_type is tree.DESCRIPTOR or depth > 4
            if depth < _DEEPEST and (not own or tree.HasField(part.name)):
                _descend_protobuf(value, here, found, depth + 1)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found[here] = 1
        elif hasattr(value, "__len__") and len(value) and isinstance(value[0], int | float):
            found[here] = len(value)


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
        return json_decoder()
    if encoding == "protobuf":
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
