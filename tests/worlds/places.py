"""Where the tests find what lies beside them."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_logs"  #: small recordings that every clone has
DATA = ROOT.parent / "shared" / "data"  #: measured recordings; what needs them is skipped without
