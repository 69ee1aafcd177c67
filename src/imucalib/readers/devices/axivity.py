"""Axivity AX3 and AX6: CSV exports of OmGui (their .cwa files are read by `cwa`)."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "axivity",
    FieldMapping(time="1", acc=("2", "3", "4"), acc_unit="g"),
    source="wadpac/GGIR, inst/testfiles/ax3_testfile.csv",
)
