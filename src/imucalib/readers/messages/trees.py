"""JSON and protobuf messages: parsed a block at a time, then read by field paths.

A path is the field names joined by dots; a number stands for a place in a list.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UsageError
from imucalib.readers.csv.time import MISSING, TextTime, text_to_ns
from imucalib.readers.messages.columns import Decoded, Widths
from imucalib.readers.messages.definition import LayoutError
from imucalib.readers.messages.layout import Groups
from imucalib.readers.messages.records import MessageBlock, Schema

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
        texts = [_utc(value).replace("T", " ") for value in values]
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


def _utc(text: str) -> str:
    if text.endswith(("Z", "+00:00")):
        return text.removesuffix("Z").removesuffix("+00:00")
    raise ValueError("a text time must be UTC and end in Z")


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

    return TreeDecoder(parse, _flatten_protobuf, _protobuf_step)


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


def _protobuf_step(tree: Any, key: str) -> Any:
    return tree[int(key)] if key.isdigit() else getattr(tree, key)


def _flatten_protobuf(tree: Any) -> dict[str, int]:
    found: dict[str, int] = {}
    _descend_protobuf(tree, "", found)
    return found


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
