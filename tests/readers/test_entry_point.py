"""A format that few use can live in a package of its own, which an entry point makes known."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

READER = """
from imucalib.readers.joining import join
from imucalib.recording.recording import Channel, Recording
import numpy as np


class TallyReader:
    name, suffixes = "tally", (".tally",)

    def recognises(self, path, head):
        return head.startswith(b"TALLY1")

    def read(self, path, mapping, *, strict):
        return join(self.blocks(path, mapping, block_samples=9, strict=strict), str(path))

    def blocks(self, path, mapping, *, block_samples, strict):
        values = np.frombuffer(path.read_bytes()[6:]).reshape(-1, 3)
        t = np.arange(len(values)) / 50.0
        channel = Channel(t, values, "m/s2", "acceleration", "imu0", 50.0)
        yield Recording({"imu0/acceleration": channel}, str(path), self.name, "0" * 64, None)


READER = TallyReader()
"""


def test_a_reader_of_another_package_reads_its_files(tmp_path: Path) -> None:

    site, log = tmp_path / "site", tmp_path / "one.log"
    facts = site / "tally_reader-1.0.dist-info"
    facts.mkdir(parents=True)
    (site / "tally_reader.py").write_text(READER)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: tally-reader\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[imucal.readers]\ntally = tally_reader:READER\n")
    rng = np.random.default_rng(1)
    log.write_bytes(b"TALLY1" + (rng.normal((0.0, 0.0, 9.81), 0.02, (500, 3))).tobytes())
    code = f"import sys; sys.path.insert(0, {str(site)!r}); from imucalib.cli import main; main()"
    run = [sys.executable, "-c", code, "inspect", str(log), "--json"]
    found = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    assert '"format": "tally"' in found
    assert "imu0/acceleration" in found
