"""Where the tests find what lies beside them."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_logs"  #: small recordings that every clone has
MEASURED = ROOT / "tests" / "measured"  #: measured recordings of the tests
#: Measured recordings that their licence keeps out of a clone; what needs them is skipped without.
DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="recordings that no clone may hold")


def script(path: str) -> ModuleType:
    """A file of the project that is no module of the program."""
    name = Path(path).stem
    spec = importlib.util.spec_from_file_location(name, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    made = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made
