"""Logs of messages: MCAP with protobuf, and bags of rosbags."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.recording.mapping import FieldMapping
from worlds.dialects import ACC, DEG, RATES, START, G, N, dialect

SI = FieldMapping(acc_unit="m/s2", gyro_unit="rad/s")
GONE = np.isin(np.arange(N), [3, 200, 201, 500])
NS = START * 10**9 + np.arange(N) * 10_000_000


def proto(
    folder: Path,
    types: dict[str, list[tuple]],
    message: Callable[[Any, int], Any],
    rows: Iterable[int] = range(N),
) -> Path:
    """An MCAP file of messages of the last type. types : name -> fields (name, type or the name of
    one, more of the descriptor's)"""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
    from mcap.writer import Writer

    file = descriptor_pb2.FileDescriptorProto(name="own.proto", package="own", syntax="proto3")
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    file.dependency.append(stamp.name)
    for name, fields in types.items():
        kind = file.message_type.add(name=name)
        for number, (label, of, *more) in enumerate(fields, start=1):
            own = {"label": 3 if "repeated" in more else 1}
            own |= {"type": 11, "type_name": of} if isinstance(of, str) else {"type": of}
            one = kind.field.add(name=label, number=number, **own)
            if "optional" in more:
                one.proto3_optional = True
                one.oneof_index = len(kind.oneof_decl)
                kind.oneof_decl.add(name=f"_{label}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(stamp)
    pool.Add(file)
    make = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"own.{name}"))
    schema = descriptor_pb2.FileDescriptorSet(file=[stamp, file]).SerializeToString()
    with (folder / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        topic = writer.register_channel(
            "/imu", "protobuf", writer.register_schema(f"own.{name}", "protobuf", schema)
        )
        for k in rows:
            data = message(make, k).SerializeToString()
            writer.add_message(topic, int(NS[k]) + 500_000, data, int(NS[k]))
        writer.finish()
    return folder / "a.mcap"


F8, F4, I8, I4, TEXT = 1, 2, 3, 5, 9
STAMP = ".google.protobuf.Timestamp"
VECTOR = {"Vector": [("x", F8), ("y", F8), ("z", F8)]}


def xyz(v) -> dict[str, float]:
    return dict(zip("xyz", map(float, v), strict=True))


def stamp(k: int) -> dict[str, int]:
    return {"seconds": int(NS[k]) // 10**9, "nanos": int(NS[k]) % 10**9}


PLAIN = VECTOR | {"Imu": [("acc", ".own.Vector"), ("gyro", ".own.Vector")]}


@dialect("protobuf", mapping=SI)
def nested(folder: Path) -> Path:
    return proto(folder, PLAIN, lambda make, k: make(acc=xyz(ACC[k]), gyro=xyz(RATES[k])))


@dialect("protobuf", mapping=SI)
def nested_stamped(folder: Path) -> Path:
    types = VECTOR | {
        "Imu": [
            ("stamp", STAMP),
            ("linear_acceleration", ".own.Vector"),
            ("angular_velocity", ".own.Vector"),
        ]
    }
    return proto(
        folder,
        types,
        lambda make, k: make(
            stamp=stamp(k), linear_acceleration=xyz(ACC[k]), angular_velocity=xyz(RATES[k])
        ),
    )


@dialect("protobuf", mapping=SI)
def flat(folder: Path) -> Path:
    names = [f"{q}_{a}" for q in ("accel", "gyro") for a in "xyz"]
    return proto(
        folder,
        {"Imu": [("timestamp_us", I8), *((n, F8) for n in names)]},
        lambda make, k: make(
            timestamp_us=int(NS[k]) // 1000,
            **dict(zip(names, map(float, [*ACC[k], *RATES[k]]), strict=True)),
        ),
    )


@dialect("protobuf", mapping=SI, resolution=1e-6)
def flat_f4(folder: Path) -> Path:
    names = ["ax", "ay", "az", "gx", "gy", "gz"]
    return proto(
        folder,
        {"Imu": [(n, F4) for n in names]},
        lambda make, k: make(**dict(zip(names, map(float, [*ACC[k], *RATES[k]]), strict=True))),
    )


@dialect("protobuf", mapping=SI)
def packed_lists(folder: Path) -> Path:
    types = {"Imu": [("acceleration", F8, "repeated"), ("angular_rate", F8, "repeated")]}
    return proto(folder, types, lambda make, k: make(acceleration=ACC[k], angular_rate=RATES[k]))


@dialect("protobuf", mapping=SI)
def lists_of_samples(folder: Path) -> Path:
    types = PLAIN | {"Batch": [("samples", ".own.Imu", "repeated")]}
    types["Imu"] = [("t", F8), *PLAIN["Imu"]]
    return proto(
        folder,
        types,
        lambda make, k: make(
            samples=[
                {"t": j / 100, "acc": xyz(ACC[j]), "gyro": xyz(RATES[j])} for j in range(k, k + 10)
            ]
        ),
        range(0, N, 10),
    )


@dialect("protobuf", mapping=SI, kept=~GONE)
def vectors_not_set(folder: Path) -> Path:
    return proto(
        folder,
        PLAIN,
        lambda make, k: make() if GONE[k] else make(acc=xyz(ACC[k]), gyro=xyz(RATES[k])),
    )


@dialect("protobuf", mapping=SI, kept=~GONE)
def optional_numbers_not_set(folder: Path) -> Path:
    names = [f"{q}_{a}" for q in ("accel", "gyro") for a in "xyz"]
    return proto(
        folder,
        {"Imu": [(n, F8, "optional") for n in names]},
        lambda make, k: (
            make()
            if GONE[k]
            else make(**dict(zip(names, map(float, [*ACC[k], *RATES[k]]), strict=True)))
        ),
    )


@dialect("protobuf", resolution=6e-3, turn={"imu0": np.rint(RATES / DEG * 1e3) * DEG / 1e3})
def whole_milli_units(folder: Path) -> Path:
    names = [f"{q}_{a}_{u}" for q, u in (("acc", "mg"), ("gyro", "mdps")) for a in "xyz"]
    values = np.rint(np.column_stack([ACC / G * 1e3, RATES / DEG * 1e3])).astype(int)
    return proto(
        folder,
        {"Imu": [(n, I4) for n in names]},
        lambda make, k: make(**dict(zip(names, map(int, values[k]), strict=True))),
    )


@dialect(
    "protobuf",
    mapping=SI,
    force={"left": ACC, "right": -ACC},
    turn={"left": RATES, "right": 2 * RATES},
)
def two_sensors(folder: Path) -> Path:
    types = PLAIN | {"Both": [("left", ".own.Imu"), ("right", ".own.Imu")]}
    return proto(
        folder,
        types,
        lambda make, k: make(
            left={"acc": xyz(ACC[k]), "gyro": xyz(RATES[k])},
            right={"acc": xyz(-ACC[k]), "gyro": xyz(2 * RATES[k])},
        ),
    )


@dialect("protobuf", mapping=SI)
def deep(folder: Path) -> Path:
    types = PLAIN | {
        "State": [("imu", ".own.Imu")],
        "Report": [("id", I4), ("state", ".own.State")],
    }
    return proto(
        folder,
        types,
        lambda make, k: make(id=k, state={"imu": {"acc": xyz(ACC[k]), "gyro": xyz(RATES[k])}}),
    )


@dialect("protobuf", mapping=SI)
def gravity_beside(folder: Path) -> Path:
    types = VECTOR | {
        "Imu": [
            ("gravity", ".own.Vector"),
            ("linear_acceleration", ".own.Vector"),
            ("acceleration", ".own.Vector"),
            ("omega", ".own.Vector"),
        ]
    }
    return proto(
        folder,
        types,
        lambda make, k: make(
            gravity=xyz(ACC[k]),
            linear_acceleration=xyz(0.001 * ACC[k]),
            acceleration=xyz(ACC[k]),
            omega=xyz(RATES[k]),
        ),
    )


@dialect("protobuf", expected="refused")
def only_orientation(folder: Path) -> Path:
    types = {"Imu": [(n, F8) for n in ("w", "x", "y", "z")]}
    return proto(folder, types, lambda make, k: make(w=1.0))


@dialect("protobuf", mapping=SI)
def stored_out_of_order(folder: Path) -> Path:
    rows = np.random.default_rng(2).permutation(N).tolist()
    return proto(folder, PLAIN, lambda make, k: make(acc=xyz(ACC[k]), gyro=xyz(RATES[k])), rows)


# -- bags -------------------------------------------------------------------------------------


def bag(
    folder: Path,
    version: int,
    topics: dict[str, tuple[str, Callable[[Any, int], Any]]],
    mode: str = "",
    storage: str = "",
    rows: Iterable[int] = range(N),
) -> Path:
    """A bag: topic -> its type, and what makes a message of a store's types and a row."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    path = folder / ("a.bag" if version == 1 else "a")
    if version == 1:
        writer: Any = rosbag1.Writer(path)
        if mode:
            writer.set_compression(rosbag1.Writer.CompressionFormat[mode])
    else:
        plugin = {"storage_plugin": rosbag2.StoragePlugin[storage]} if storage else {}
        writer = rosbag2.Writer(path, version=9, **plugin)
        if mode:
            writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with writer:
        open_ = {
            t: writer.add_connection(t, kind, typestore=store) for t, (kind, _) in topics.items()
        }
        for k in rows:
            for topic, (kind, make) in topics.items():
                writer.write(open_[topic], int(NS[k]) + 300_000, pack(make(store.types, k), kind))
    return path


def header(types: Any, k: int, zero: bool = False, offset: int = 0, frame: str = "imu") -> Any:
    ns = 0 if zero else int(NS[k]) + offset
    time = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    more = {"seq": k} if "seq" in types["std_msgs/msg/Header"].__annotations__ else {}
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **more)


def vector(types: Any, v: Any) -> Any:
    return types["geometry_msgs/msg/Vector3"](**xyz(v))


IMU = "sensor_msgs/msg/Imu"


def imu(acc=ACC, rate=RATES, **stamped: Any) -> tuple[str, Callable[[Any, int], Any]]:
    def make(types: Any, k: int) -> Any:
        none = np.zeros(9)
        return types[IMU](
            header=header(types, k, **stamped),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=none,
            angular_velocity=vector(types, rate[k]),
            angular_velocity_covariance=none,
            linear_acceleration=vector(types, acc[k]),
            linear_acceleration_covariance=none,
        )

    return IMU, make


def stamped(kind: str, values: Any) -> tuple[str, Callable[[Any, int], Any]]:
    full = f"geometry_msgs/msg/{kind}"

    def make(types: Any, k: int) -> Any:
        own = vector(types, values[k])
        if kind == "AccelStamped":
            own = types["geometry_msgs/msg/Accel"](linear=own, angular=vector(types, [0, 0, 0]))
            return types[full](header=header(types, k), accel=own)
        if kind == "TwistStamped":
            own = types["geometry_msgs/msg/Twist"](linear=vector(types, [0, 0, 0]), angular=own)
            return types[full](header=header(types, k), twist=own)
        return types[full](header=header(types, k), vector=own)

    return full, make


for _version, _mode, _storage in (
    (1, "", ""),
    (1, "BZ2", ""),
    (1, "LZ4", ""),
    (2, "", ""),
    (2, "FILE", ""),
    (2, "MESSAGE", ""),
    (2, "", "MCAP"),
):

    def _write(folder: Path, of=(_version, _mode, _storage)) -> Path:
        return bag(folder, of[0], {"/imu/data": imu()}, of[1], of[2])

    _write.__name__ = f"ros{_version}_{_mode or 'plain'}_{_storage or 'own'}".lower()
    dialect("rosbags", dated=True)(_write)


BOTH = {"force": {"left": ACC, "right": -ACC}, "turn": {"left": RATES, "right": 2 * RATES}}
for _version in (1, 2):

    def _two(folder: Path, v=_version) -> Path:
        right = imu(-ACC, 2 * RATES, frame="r")
        return bag(folder, v, {"/left/imu": imu(), "/right/imu": right})

    def _zero(folder: Path, v=_version) -> Path:
        return bag(folder, v, {"/imu": imu(zero=True)})

    def _late(folder: Path, v=_version) -> Path:
        return bag(folder, v, {"/imu": imu(offset=-3600 * 10**9)})

    def _halves(folder: Path, v=_version) -> Path:
        none = np.zeros_like(ACC)
        return bag(
            folder, v, {"/cam/accel/sample": imu(ACC, none), "/cam/gyro/sample": imu(none, RATES)}
        )

    def _vectors(folder: Path, v=_version) -> Path:
        return bag(
            folder,
            v,
            {
                "/imu/acceleration": stamped("Vector3Stamped", ACC),
                "/imu/angular_velocity": stamped("Vector3Stamped", RATES),
            },
        )

    def _moved(folder: Path, v=_version) -> Path:
        rows = np.arange(N).reshape(-1, 4)[:, [1, 0, 3, 2]].reshape(-1).tolist()
        return bag(folder, v, {"/imu": imu()}, rows=rows)

    for _name, _one, _facts in (
        ("two", _two, BOTH),
        ("stamps_of_zero", _zero, {}),
        ("stamps_an_hour_off", _late, {"dated": None}),
        ("halves", _halves, {}),
        ("vectors", _vectors, {"mapping": SI}),
        ("out_of_order", _moved, {}),
    ):
        _one.__name__ = f"ros{_version}_{_name}"
        dialect("rosbags", **{"dated": True, **_facts})(_one)


@dialect("rosbags", dated=True, expected="refused")
def joint_states_alone(folder: Path) -> Path:
    def make(types: Any, k: int) -> Any:
        return types["sensor_msgs/msg/JointState"](
            header=header(types, k),
            name=["a", "b", "c"],
            position=ACC[k],
            velocity=RATES[k],
            effort=ACC[k],
        )

    return bag(folder, 2, {"/joints": ("sensor_msgs/msg/JointState", make)})


NAMED = FieldMapping(
    acc=("/acc:accel.linear",), gyro=("/gyro:twist.angular",), acc_unit="m/s2", gyro_unit="rad/s"
)


@dialect("rosbags", dated=True, mapping=NAMED)
def accel_and_twist(folder: Path) -> Path:
    topics = {"/acc": stamped("AccelStamped", ACC), "/gyro": stamped("TwistStamped", RATES)}
    return bag(folder, 2, topics)
