"""YAML that every reader takes the same way: floats always with a point and an exponent sign."""

from __future__ import annotations

from io import StringIO
from typing import Any

import numpy as np


def dump(content: dict[str, Any]) -> str:
    """YAML 1.2 text of plain types; number lists on one line; floats like 1.0e-03 (YAML 1.1 reads
    "1e-3" as a string)."""
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import RoundTripRepresenter

    class Representer(RoundTripRepresenter):
        pass

    def number(self: RoundTripRepresenter, value: float) -> Any:
        return self.represent_scalar("tag:yaml.org,2002:float", _float(float(value)))

    def sequence(self: RoundTripRepresenter, value: list[Any]) -> Any:
        flat = all(isinstance(v, int | float | str) for v in value) and len(value) < 64
        return self.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=flat)

    Representer.add_representer(float, number)
    Representer.add_representer(np.float64, number)
    Representer.add_representer(list, sequence)
    yaml = YAML()
    yaml.Representer = Representer
    yaml.default_flow_style = False
    yaml.width = 4096
    text = StringIO()
    yaml.dump(content, text)
    return text.getvalue()


def _float(value: float) -> str:
    if not np.isfinite(value):
        return ".nan" if np.isnan(value) else ".inf" if value > 0 else "-.inf"
    text = repr(value)
    if "e" in text:
        mantissa, exponent = text.split("e")
        if "." not in mantissa:
            mantissa += ".0"
        return f"{mantissa}e{int(exponent):+03d}"
    return text
