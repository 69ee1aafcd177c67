"""GENEActiv: CSV exports of its software (its .bin files are read by `geneactiv_bin`)."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

_EXAMPLE = """Device Type,GENEActiv
Device Model,1.1
Device Unique Serial Code,11152
Device Firmware Version,Ver1.30 date 05Aug11
Calibration Date,2011-09-07 19:20:18:000
Application name & version ,GENEActiv PC Software 2.1
\n\n\n\n\
Measurement Frequency,100 Hz
Start Time,2011-10-09 10:20:00:000
Last measurement,
Device Location Code,right wrist
Time Zone,GMT +01
\n\n\n\n\n\
Subject Code,Example
Date of Birth,01/01/1900
Sex,
Height,178
Weight,67
Handedness Code,right
Subject Notes,
\n\n\n\
Study Centre,
Study Code,
Investigator ID,
Exercise Type,
Config Operator ID,
Config Time,2011-10-09 10:16:39:671:
Config Notes,Notes
Extract Operator ID,
Extract Time,2011-10-9 11:24:8:453
Extract Notes,
\n\n\n\n\n\n\n\n\n\n\
Sensor type,MEMS accelerometer x-axis
Range,-8 to 8
Resolution,0.0039
Units,g
Additional information,
Sensor type,MEMS accelerometer y-axis
Range,-8 to 8
Resolution,0.0039
Units,g
Additional information,
Sensor type,MEMS accelerometer z-axis
Range,-8 to 8
Resolution,0.0039
Units,g
Additional information,
Sensor type,Lux Photodiode 400nm - 1100nm
Range,0 to 5000
Resolution,5
Units,lux
Additional information,
Sensor type,User button event marker
Range,1 or 0
Resolution,
Units,
Additional information,1=pressed
Sensor type,Linear active thermistor
Range,0 to 70
Resolution,0.1
Units,deg. C
Additional information,
\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\
2011-10-09 10:25:02:500,-0.421,-0.6751,0.305,48,0,24.5
2011-10-09 10:25:02:510,-0.3552,-0.7253,0.309,48,0,24.5
2011-10-09 10:25:02:520,-0.2236,-0.791,0.2614,48,0,24.5
2011-10-09 10:25:02:530,-0.0494,-0.8605,0.2693,48,0,24.5
2011-10-09 10:25:02:540,0.1595,-0.9609,0.2455,48,0,24.5
2011-10-09 10:25:02:550,0.5002,-1.1153,0.3566,48,0,24.5
2011-10-09 10:25:02:560,1.2124,-1.3316,0.436,50,0,24.5
2011-10-09 10:25:02:570,2.1026,-1.6482,0.2653,50,0,24.5
"""

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
    example=_EXAMPLE,
    source="harvard-nrg/pygeneactiv, tests/right_wrist.csv (blanks at the ends of lines left out)",
)
