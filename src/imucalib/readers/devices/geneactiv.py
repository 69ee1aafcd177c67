"""GENEActiv: CSV exports of its software (its .bin files are read by `geneactiv_bin`)."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "geneactiv",
    FieldMapping(
        time="1",
        acc=("2", "3", "4"),
        temperature=("7",),
        time_unit="text",
        time_format="%Y-%m-%d %H:%M:%S:%f",
        acc_unit="g",
        temperature_unit="degC",
    ),
    words=("geneactiv",),
    source="harvard-nrg/pygeneactiv, tests/right_wrist.csv (blanks at the ends of lines left out)",
)
