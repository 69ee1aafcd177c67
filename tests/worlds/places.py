"""Where the tests find what lies beside them."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_logs"  #: small recordings that every clone has
MEASURED = ROOT / "tests" / "measured"  #: measured recordings of the tests
#: Measured recordings that their licence keeps out of a clone; what needs them is skipped without.
DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="recordings that no clone may hold")
