"""Results as plain types, as YAML and JSON take them."""

from __future__ import annotations

import math
from typing import Any


def plain(value: Any) -> Any:
    """Mappings, lists and Python scalars; a number that does not exist is None, never NaN."""
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
