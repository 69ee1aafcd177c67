"""Write docs/testing.md's list of options and the tests that show what they do.

python tests/options
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from options.listed import table
from testing_page import written

if __name__ == "__main__":
    written("options", table())
