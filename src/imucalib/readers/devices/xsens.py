"""Xsens: text exports of MT Manager."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

_EXAMPLE = """// Start Time: Unknown
// Update Rate: 100.0Hz
// Filter Profile: human (46.1)
// Option Flags: AHS Disabled ICC Disabled
// Firmware Version: 4.0.2
PacketCounter\tSampleTimeFine\tYear\tMonth\tDay\tSecond\tUTC_Nano\tUTC_Year\tUTC_Month\tUTC_Day\tUTC_Hour\
\tUTC_Minute\tUTC_Second\tUTC_Valid\tAcc_X\tAcc_Y\tAcc_Z\tMat[1][1]\tMat[2][1]\tMat[3][1]\tMat[1][2]\
\tMat[2][2]\tMat[3][2]\tMat[1][3]\tMat[2][3]\tMat[3][3]
00472\t\t\t\t\t\t\t\t\t\t\t\t\t\t9.681784\t0.567279\t-0.970936\t-0.102187\t-0.059505\t0.992984\t0.068831\t0.995394\
\t0.066732\t-0.992381\t0.075167\t-0.097620
00473\t\t\t\t\t\t\t\t\t\t\t\t\t\t9.703536\t0.660375\t-0.943480\t-0.102192\t-0.059407\t0.992989\t0.068608\t0.995417\
\t0.066613\t-0.992396\t0.074934\t-0.097648
00474\t\t\t\t\t\t\t\t\t\t\t\t\t\t9.726412\t0.667523\t-0.946427\t-0.102104\t-0.059314\t0.993004\t0.068465\t0.995435\
\t0.066499\t-0.992415\t0.074776\t-0.097577
00475\t\t\t\t\t\t\t\t\t\t\t\t\t\t9.690538\t0.703942\t-0.916622\t-0.102045\t-0.059230\t0.993015\t0.068183\t0.995462\
\t0.066383\t-0.992440\t0.074481\t-0.097543
00476\t\t\t\t\t\t\t\t\t\t\t\t\t\t9.699159\t0.734927\t-0.966246\t-0.101912\t-0.059215\t0.993029\t0.067825\t0.995490\
\t0.066323\t-0.992479\t0.074112\t-0.097436
"""

DEVICE = Device(
    "xsens",
    FieldMapping(
        acc_unit="m/s2",
        gyro_unit="rad/s",
    ),
    words=("mt manager", "xsens", "xda version", "filter profile:"),
    example=_EXAMPLE,
    source="opensim-org/opensim-core, OpenSenseExample/IMUData/MT_012005D6_009-001",
)
