"""EuRoC and other data sets in the layout of ASL: stamps in ns, gyroscope, accelerometer."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "euroc",
    FieldMapping(
        time="1",
        gyro=("2", "3", "4"),
        acc=("5", "6", "7"),
        time_unit="ns",
        acc_unit="m/s2",
        gyro_unit="rad/s",
    ),
    source="MIT-SPARK/Kimera-VIO, tests/data/ForOnlineAlignment/real_data",
)
