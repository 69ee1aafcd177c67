"""YAML, written so that every reader takes it the same way, and read with one kind of error."""

from __future__ import annotations

import json
import re
from io import StringIO
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from imucalib.errors import UnreadableInput

#: Words that YAML 1.1 takes for true or false: quoted, so that its readers keep them as text.
_TRUE_OR_FALSE = {"y", "yes", "on", "true", "n", "no", "off", "false"}
#: Marks of a key, which end a word in a list on one line, and a line break that only double quotes
#: keep: others fold it to a blank.
_MARKS = re.compile("[?\x85]|^:")
#: A list on one line of numbers that JSON and YAML read alike.
_NUMBER = r"-?(?:0|[1-9]\d*)(?:\.\d+(?:e[-+]\d+)?)?"
_NUMBERS = re.compile(rf"\[{_NUMBER}(?:, {_NUMBER})++\]")
#: Bytes of a file, and characters of it without such lists, which alone cost the parser time: more
#: than a calibration of a year in daily parts has.
_MOST, _MOST_PARSED = 16 << 20, 1 << 20


def content_of(path: Path, remedy: str = "") -> bytes:
    """What a file holds. Raises UnreadableInput for one that cannot be read or is too large."""
    try:
        with path.open("rb") as file:
            content = file.read(_MOST + 1)
    except OSError as error:
        what = f"the file cannot be read: {error.strerror or error}"
        raise UnreadableInput(what, where=str(path), remedy=remedy) from None
    if len(content) > _MOST:
        what = f"it is larger than {_MOST >> 20} MiB"
        raise UnreadableInput(what, where=str(path), remedy=remedy)
    return content


def load(path: Path, remedy: str = "") -> Any:
    """The content of a YAML 1.2 file as plain types. Anchors and aliases, by which ten lines become
    gigabytes, are refused: nothing that is written here has any.

    Raises UnreadableInput, with `remedy`, when the file cannot be read or is not YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.composer import Composer
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    class Plain(Composer):
        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.parser.peek_event()
            if getattr(event, "anchor", None) is not None:
                what = f"it has the anchor or alias '{str(event.anchor)[:40]}'"
                raise MarkedYAMLError(problem=what, problem_mark=event.start_mark)
            return super().compose_node(parent, index)

    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = Plain
    # Thousands of numbers of a covariance: a list of one mark for the parser, then these.
    mark, lists = f"x{uuid4().hex}x", list[str]()

    def marked(found: re.Match[str]) -> str:
        lists.append(found[0])
        return f"[{mark}{len(lists) - 1}x]"

    held = content_of(path, remedy)
    try:
        text = _NUMBERS.sub(marked, held.decode("utf-8"))
        if len(text) > _MOST_PARSED:
            raise ValueError(f"it has more than {_MOST_PARSED >> 20} MiB beside numbers")
        return _unmark(yaml.load(text), re.compile(f"\\[?{mark}(\\d+)x\\]?"), lists)
    except RecursionError:
        what = "not a YAML file: it is nested too deep"
    except UnicodeDecodeError:
        what = "not a YAML file, nor any other text"
    except MarkedYAMLError as error:
        line = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        what = f"not a YAML file: {error.problem or error.context}{line}"
    except (YAMLError, ValueError) as error:
        what = f"not a YAML file: {error}"
    raise UnreadableInput(what, where=str(path), remedy=remedy)


def _unmark(content: Any, mark: re.Pattern[str], lists: list[str]) -> Any:
    """Content with the numbers in their places; within a text, as they were written."""
    if isinstance(content, dict):
        pairs = content.items()
        return {_unmark(k, mark, lists): _unmark(v, mark, lists) for k, v in pairs}
    if isinstance(content, list):
        found = mark.fullmatch(str(content[0])) if len(content) == 1 else None
        if found and not content[0].startswith("["):
            return json.loads(lists[int(found[1])])
        return [_unmark(v, mark, lists) for v in content]
    if isinstance(content, tuple):  # a list that is a key
        return tuple(_unmark(list(content), mark, lists))
    if isinstance(content, str):
        return mark.sub(lambda found: lists[int(found[1])], content)
    return content


def dump(content: dict[str, Any], *, indented: bool = False) -> str:
    """YAML text of plain types that 1.1 and 1.2 read alike; number lists on one line; floats like
    1.0e-03 (YAML 1.1 reads "1e-3" as a string).

    indented : whether lists stand two blanks further in, which OpenCV asks for
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import RoundTripRepresenter

    class Representer(RoundTripRepresenter):
        pass

    def number(self: RoundTripRepresenter, value: float) -> Any:
        return self.represent_scalar("tag:yaml.org,2002:float", _float(float(value)))

    def text(self: RoundTripRepresenter, value: str) -> Any:
        value = value.encode("utf-8", "backslashreplace").decode()  # a file name may be any bytes
        style = '"' if value.lower() in _TRUE_OR_FALSE or _MARKS.search(value) else None
        return self.represent_scalar("tag:yaml.org,2002:str", value, style=style)

    mark, lines = f"x{uuid4().hex}x", list[str]()

    def sequence(self: RoundTripRepresenter, value: list[Any]) -> Any:
        if value and all(type(v) is float for v in value):
            # Thousands of numbers of a covariance: a mark now, the numbers in its place at the end.
            lines.append("[" + ", ".join(_float(v) for v in value) + "]")
            return self.represent_scalar("tag:yaml.org,2002:str", f"{mark}{len(lines) - 1}x")
        flat = all(isinstance(v, int | float | str) for v in value) and len(value) < 64
        return self.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=flat)

    Representer.add_representer(float, number)
    Representer.add_representer(np.float64, number)
    Representer.add_representer(str, text)
    Representer.add_representer(list, sequence)
    yaml = YAML()
    yaml.Representer = Representer
    yaml.default_flow_style = False
    yaml.width = 4096
    if indented:
        yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    yaml.dump(content, stream)
    return re.sub(f"{mark}(\\d+)x", lambda m: lines[int(m[1])], stream.getvalue())


def _float(value: float) -> str:
    if not np.isfinite(value):
        return ".nan" if np.isnan(value) else ".inf" if value > 0 else "-.inf"
    mantissa, e, exponent = repr(value).partition("e")
    if not e:
        return mantissa
    return f"{mantissa if '.' in mantissa else f'{mantissa}.0'}e{int(exponent):+03d}"
