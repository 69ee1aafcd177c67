"""Documents for programs as types: the JSON, its schema and the page about it are one list of keys.

`Data` is a frozen dataclass. Its fields are keys, in order; what a key means, and in which unit it
is where its name does not say so, is `Annotated`. A key whose default is None is left out where it
has no value; any other number that does not exist is null.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field, dataclass, field, is_dataclass
from operator import attrgetter
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

#: A number that does not exist is null.
_PLAIN: dict[Any, dict[str, Any]] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": ["number", "null"]},
    NoneType: {"type": "null"},
}
#: Written `schema`, first in a document.
_NAME = "imucal/{}"
#: What has an end of its own in JSON.
_MANY = (dict, list, tuple)


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Data:
    """A part of a document, or, with a name such as "noise/1", a document.

    kw_only : as of dataclasses; sparse : whether every key that is empty is left out
    beside : (document, key, value): its keys stand beside the document's where that key has this
        value
    """

    schema_name: ClassVar[str] = ""
    beside: ClassVar[tuple[str, str, str] | None] = None
    sparse: ClassVar[bool] = False

    def __init_subclass__(
        cls,
        name: str = "",
        *,
        kw_only: bool = False,
        beside: tuple[str, str, str] | None = None,
        sparse: bool = False,
    ) -> None:
        super().__init_subclass__()
        cls.schema_name, cls.beside, cls.sparse = name, beside, sparse
        dataclass(frozen=True, kw_only=kw_only)(cls)

    @classmethod
    def of(cls, source: object, renamed: str = "", **stated: Any) -> Self:
        """From what is stated, and else from an object's attributes of the same names.

        renamed : keys whose attribute has another name: "rate_hz=clock.rate start_s=start"
        """
        paths = dict(one.split("=") for one in renamed.split())
        names = [one.name for one in dataclasses.fields(cls) if one.init and one.name not in stated]  # type: ignore[arg-type]
        read = {name: attrgetter(paths.get(name, name))(source) for name in names}
        return cls(**read, **stated)

    def as_dict(self) -> dict[str, Any]:
        """Plain types, ready for JSON; of a document with its schema's name."""
        content = {"schema": _NAME.format(self.schema_name)} if self.schema_name else {}
        each = ((one, getattr(self, one.name)) for one in dataclasses.fields(self))  # type: ignore[arg-type]
        return content | {
            one.name: plain(value)
            for one, value in each
            if not (value is None and one.default is None) and not (self.sparse and not value)
        }


def plain(value: Any) -> Any:
    """Mappings, lists and Python scalars, data by their keys, a dataclass by its fields; a number
    that does not exist is None, never NaN."""
    if isinstance(value, Data):
        return value.as_dict()
    if is_dataclass(value):
        value = vars(value)
    if hasattr(value, "items"):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    number = float(value)
    return number if math.isfinite(number) else None


def fields(source: object, names: str) -> dict[str, Any]:
    """Some attributes of an object as plain types, in their order.

    names : separated by blanks; "rate_hz=clock.rate" is an attribute's attribute by its own name
    """
    parts = (name.rpartition("=") for name in names.split())
    return {key or path: plain(attrgetter(path)(source)) for key, _, path in parts}


def list_fields(sources: Iterable[object], names: str) -> list[dict[str, Any]]:
    """`fields` of each of some objects."""
    return [fields(source, names) for source in sources]


def json_text(content: Any, indent: str = "") -> str:
    """JSON of plain types; a list of numbers or words is on one line. Raises ValueError for NaN."""
    inner, ends, lines = indent + "  ", "[]", list[str]()
    if isinstance(content, dict) and content:
        ends = "{}"
        lines = [
            f"{json.dumps(k, ensure_ascii=False)}: {json_text(v, inner)}"
            for k, v in content.items()
        ]
    elif isinstance(content, list | tuple) and any(isinstance(v, _MANY) for v in content):
        lines = [json_text(v, inner) for v in content]
    if not lines:
        return json.dumps(content, ensure_ascii=False, allow_nan=False)
    return f"{ends[0]}\n{inner}" + f",\n{inner}".join(lines) + f"\n{indent}{ends[1]}"


def documents() -> dict[str, list[type[Data]]]:
    """Every form of every document that is imported, by the part of its name before the version,
    and after them what stands beside."""
    found: dict[str, list[type[Data]]] = {}
    waiting, parts = [Data], []
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        if cls.schema_name:
            found.setdefault(cls.schema_name.partition("/")[0], []).append(cls)
        elif cls.beside:
            parts.append((cls.beside[0], cls))
    for name, cls in sorted(parts, key=lambda part: part[1].__name__):
        found[name].append(cls)
    return dict(sorted(found.items()))


def schema_of(forms: Sequence[type[Data]]) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a document of one or more forms: the first line of a form's
    docstring says what it is, and no key is there that the form does not name. A form with parts
    beside it is open to the keys of a part that is no type yet."""
    name = _NAME.format(forms[0].schema_name)
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": name,
        "title": name.replace("/", " ").rpartition(" ")[0],
    }
    own = sorted((form for form in forms if not form.beside), key=lambda form: form.__name__)
    bodies = [_schema_of_keys(form) for form in own]
    for body in bodies:
        body["required"].insert(0, "schema")
        body["properties"] = {"schema": {"const": name}, **body["properties"]}
    if len(bodies) > 1:
        return head | {"oneOf": bodies}
    beside: dict[tuple[str, str], list[Any]] = {}
    for form in forms:
        if form.beside:
            own_keys = _schema_of_keys(form) | {"additionalProperties": True}
            beside.setdefault(form.beside[1:], []).append(own_keys)
    parts = [
        {"if": {"properties": {key: {"const": value}}}, "then": {"anyOf": each}}
        for (key, value), each in beside.items()
    ]
    return head | bodies[0] | ({"additionalProperties": True, "allOf": parts} if parts else {})


def _schema(kind: Any) -> dict[str, Any]:
    """Of what an annotation allows."""
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return {"description": inside[1], **_schema(inside[0])}
    if origin in (Union, UnionType):
        return _schema_of_either([_schema(one) for one in inside])
    if is_dataclass(kind):
        return _schema_of_keys(kind)
    return _schema_of_many(origin, inside) if origin else dict(_PLAIN.get(kind, {}))


def _schema_of_many(origin: Any, inside: tuple[Any, ...]) -> dict[str, Any]:
    """Of a choice of words, a list, a mapping or an array of any shape."""
    if origin is Literal:
        return {"enum": list(inside)}
    if origin in (tuple, list):
        each = [_schema(one) for one in inside if one is not ...]
        return {"type": "array", "items": _schema_of_either(each)}
    if origin.__name__ == "ndarray":
        return {"type": "array"}
    return {"type": "object", "additionalProperties": _schema(inside[1])}


def _schema_of_either(each: list[dict[str, Any]]) -> dict[str, Any]:
    """One of several; as one list of types where all of them are plain."""
    if all(set(one) == {"type"} for one in each):
        return {"type": list(dict.fromkeys(kind for one in each for kind in _types(one)))}
    rest = [one for one in each if one != _PLAIN[NoneType]]
    if len(rest) == 1 and "type" in rest[0]:
        return {**rest[0], "type": list(dict.fromkeys([*_types(rest[0]), "null"]))}
    return {"anyOf": each}


def _types(schema: Mapping[str, Any]) -> list[str]:
    kinds = schema["type"]
    return kinds if isinstance(kinds, list) else [kinds]


def _schema_of_keys(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    own: tuple[Field[Any], ...] = dataclasses.fields(kind)
    sparse = getattr(kind, "sparse", False)
    return {
        "description": (kind.__doc__ or "").partition("\n")[0],
        "type": "object",
        "required": [one.name for one in own if one.default is not None and not sparse],
        "properties": {one.name: _schema(_drop_none(one, hints[one.name])) for one in own},
        "additionalProperties": False,
    }


def _drop_none(field: Field[Any], hint: Any) -> Any:
    """What a key holds where it is there: one that may be left out is never null."""
    if field.default is not None or get_origin(hint) is Annotated:
        return hint
    rest = tuple(one for one in get_args(hint) if one is not NoneType)
    return Union[rest] if rest else hint  # noqa: UP007
