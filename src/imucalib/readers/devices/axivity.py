"""Axivity AX3 and AX6: CSV exports of OmGui (their .cwa files are read by `cwa`)."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

_EXAMPLE = """1551178506.0000,0.328125,0.984375,0.203125
1551178506.0100,0.828125,-0.359375,-0.375000
1551178506.0200,0.875000,-0.390625,-0.390625
1551178506.0300,0.890625,-0.390625,-0.390625
1551178506.0400,0.890625,-0.375000,-0.390625
1551178506.0500,0.875000,-0.359375,-0.375000
1551178506.0600,0.875000,-0.359375,-0.390625
1551178506.0700,0.875000,-0.359375,-0.406250
"""

DEVICE = Device(
    "axivity",
    FieldMapping(time="1", acc=("2", "3", "4"), acc_unit="g"),
    example=_EXAMPLE,
    source="wadpac/GGIR, inst/testfiles/ax3_testfile.csv",
)
