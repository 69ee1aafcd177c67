"""netCDF files as xarray and netCDF4 write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from worlds.dialects import ACC, DEG, RATES, START, G, N, T, dialect

GONE = np.isin(np.arange(N), [3, 200, 201, 500])


def stamps():
    return (START * 10**9 + np.arange(N) * 10_000_000).astype("M8[ns]")


def xr(variables, time=None, **coords):
    import xarray

    time = T if time is None else time
    return xarray.Dataset(variables, coords={"time": ("time", time), **coords})


def whole(dims=("time", "axis"), acc=ACC, rate=RATES, units=("m s-2", "rad s-1")):
    return {
        name: (dims, values if dims[0] == "time" else values.T, {"units": unit})
        for name, values, unit in zip(
            ("acceleration", "angular_velocity"), (acc, rate), units, strict=True
        )
    }


def apart(unit=("m/s^2", "rad/s")):
    names = [f"{q}_{a}" for q in ("acc", "gyro") for a in "xyz"]
    columns = [*ACC.T, *RATES.T]
    return {
        n: ("time", c, {"units": unit[k // 3]})
        for k, (n, c) in enumerate(zip(names, columns, strict=True))
    }


def saved(data, folder: Path, **options) -> Path:
    data.to_netcdf(folder / "a.nc", engine=options.pop("engine", "netcdf4"), **options)
    return folder / "a.nc"


@dialect("xarray", dated=True)
def columns_dated(folder: Path) -> Path:
    return saved(xr(apart(), stamps()), folder)


@dialect("xarray")
def columns_seconds(folder: Path) -> Path:
    data = xr(apart())
    data["time"].attrs["units"] = "s"
    return saved(data, folder)


@dialect("xarray")
def vectors(folder: Path) -> Path:
    return saved(xr(whole()), folder)


@dialect("xarray", dated=True)
def vectors_named_axes(folder: Path) -> Path:
    return saved(xr(whole(), stamps(), axis=list("xyz")), folder)


@dialect("xarray")
def vectors_zyx(folder: Path) -> Path:
    data = whole(acc=ACC[:, ::-1], rate=RATES[:, ::-1])
    return saved(xr(data, axis=list("zyx")), folder)


@dialect("xarray", expected="refused")
def vectors_north_east_down(folder: Path) -> Path:
    return saved(xr(whole(), axis=["north", "east", "down"]), folder)


@dialect("xarray")
def vectors_transposed(folder: Path) -> Path:
    return saved(xr(whole(("axis", "time"))), folder)


@dialect("xarray")
def vectors_transposed_zyx(folder: Path) -> Path:
    data = whole(("axis", "time"), ACC[:, ::-1], RATES[:, ::-1])
    return saved(xr(data, axis=list("zyx")), folder)


@dialect("xarray")
def vectors_packed_by_library(folder: Path) -> Path:
    encoding = {
        name: {"dtype": "i4", "scale_factor": 1e-6, "add_offset": 0.5, "_FillValue": -(2**31)}
        for name in ("acceleration", "angular_velocity")
    }
    return saved(xr(whole()), folder, encoding=encoding)


@dialect("xarray", resolution=6e-4)
def vectors_packed_i2(folder: Path) -> Path:
    encoding = {
        name: {"dtype": "i2", "scale_factor": 1e-3, "_FillValue": -32768}
        for name in ("acceleration", "angular_velocity")
    }
    return saved(xr(whole()), folder, encoding=encoding)


@dialect("xarray", kept=~GONE)
def vectors_with_nan(folder: Path) -> Path:
    acc, rate = ACC.copy(), RATES.copy()
    acc[GONE], rate[GONE] = np.nan, np.nan
    return saved(xr(whole(acc=acc, rate=rate)), folder)


@dialect("xarray", kept=~GONE)
def vectors_with_a_fill(folder: Path) -> Path:
    acc, rate = ACC.copy(), RATES.copy()
    acc[GONE], rate[GONE] = np.nan, np.nan
    encoding = {n: {"_FillValue": -9999.0} for n in ("acceleration", "angular_velocity")}
    return saved(xr(whole(acc=acc, rate=rate)), folder, encoding=encoding)


@dialect("xarray", resolution=1e-6)
def vectors_f4(folder: Path) -> Path:
    return saved(xr(whole(acc=ACC.astype("f4"), rate=RATES.astype("f4"))), folder)


@dialect("xarray", resolution=1e-6)
def vectors_in_g_and_degrees(folder: Path) -> Path:
    data = whole(acc=ACC / G, rate=RATES / DEG, units=("g", "degree/s"))
    return saved(xr(data), folder)


@dialect("xarray", resolution=1e-6)
def vectors_in_degrees_cf(folder: Path) -> Path:
    data = whole(acc=ACC, rate=RATES / DEG, units=("m s**-2", "degrees s-1"))
    return saved(xr(data), folder)


@dialect("xarray", dated=True)
def vectors_milliseconds_since(folder: Path) -> Path:
    encoding = {"time": {"units": "milliseconds since 2023-01-01", "dtype": "i8"}}
    return saved(xr(whole(), stamps()), folder, encoding=encoding)


@dialect("xarray", dated=True)
def vectors_days_since(folder: Path) -> Path:
    encoding = {"time": {"units": "days since 2023-11-14 22:00:00", "dtype": "f8"}}
    return saved(xr(whole(), stamps()), folder, encoding=encoding)


@dialect("xarray")
def vectors_timedelta(folder: Path) -> Path:
    time = (np.arange(N) * 10_000_000).astype("m8[ns]")
    return saved(xr(whole(), time), folder)


@dialect("xarray")
def compressed_unlimited(folder: Path) -> Path:
    encoding = {n: {"zlib": True} for n in ("acceleration", "angular_velocity")}
    return saved(xr(whole()), folder, encoding=encoding, unlimited_dims=["time"])


@dialect("xarray")
def by_h5netcdf(folder: Path) -> Path:
    return saved(xr(whole()), folder, engine="h5netcdf")


@dialect("xarray", expected="refused")
def by_scipy_netcdf3(folder: Path) -> Path:
    return saved(xr(apart()), folder, engine="scipy")


@dialect("xarray", force={"left": ACC, "right": -ACC}, turn={"left": RATES, "right": 2 * RATES})
def a_group_each(folder: Path) -> Path:
    saved(xr(whole()), folder, group="left")
    return saved(xr(whole(acc=-ACC, rate=2 * RATES)), folder, group="right", mode="a")


@dialect("xarray", force={"imu0": ACC, "imu1": -ACC}, turn={"imu0": RATES, "imu1": 2 * RATES})
def sensors_as_a_dimension(folder: Path) -> Path:
    data = whole(
        ("time", "sensor", "axis"), np.stack([ACC, -ACC], 1), np.stack([RATES, 2 * RATES], 1)
    )
    return saved(xr(data), folder)


@dialect("xarray", force={"imu0": ACC, "imu1": -ACC}, turn={"imu0": RATES, "imu1": 2 * RATES})
def sensors_as_a_dimension_zyx(folder: Path) -> Path:
    stacks = np.stack([ACC, -ACC], 1)[:, :, ::-1], np.stack([RATES, 2 * RATES], 1)[:, :, ::-1]
    data = whole(("time", "sensor", "axis"), *stacks)
    return saved(xr(data, axis=list("zyx"), sensor=["one", "two"]), folder)


@dialect("xarray")
def other_coordinates(folder: Path) -> Path:
    import xarray

    acc, rate = xr(whole())["acceleration"], xr(whole())["angular_velocity"]
    data = xarray.Dataset({"acc": acc.rename(time="acc_time"), "gyro": rate.rename(
        time="gyro_time")})  # fmt: skip
    return saved(data, folder)


@dialect("xarray")
def a_window_of_a_day(folder: Path) -> Path:
    data = xr(whole(), T + 41_000.0)
    data["time"].attrs["units"] = "s"
    return saved(data, folder)


def nc(folder: Path):
    from netCDF4 import Dataset

    data = Dataset(folder / "a.nc", "w")
    data.createDimension("time", None)
    data.createDimension("axis", 3)
    time = data.createVariable("time", "f8", ("time",))
    time.units = "seconds since 1970-01-01 00:00:00"
    time[:] = START + T
    return data


def put(data, name, values, unit, kind="f8", dims=("time", "axis"), **options):
    one = data.createVariable(name, kind, dims, **options)
    one.units = unit
    one[:] = values
    return one


@dialect("netCDF4", dated=True)
def nc_vectors(folder: Path) -> Path:
    with nc(folder) as data:
        put(data, "accel", ACC, "m/s2")
        put(data, "gyro", RATES, "rad/s")
    return folder / "a.nc"


@dialect("netCDF4", dated=True, resolution=6e-4)
def nc_scaled(folder: Path) -> Path:
    with nc(folder) as data:
        for name, values, unit in (("accel", ACC, "m/s2"), ("gyro", RATES, "rad/s")):
            one = data.createVariable(name, "i2", ("time", "axis"), fill_value=-32768)
            one.units, one.scale_factor, one.add_offset = unit, 1e-3, 0.25
            one[:] = values
    return folder / "a.nc"


@dialect("netCDF4", dated=True, kept=~GONE)
def nc_masked(folder: Path) -> Path:
    mask = np.repeat(GONE[:, None], 3, axis=1)
    with nc(folder) as data:
        put(data, "accel", np.ma.array(ACC, mask=mask), "m/s2")
        put(data, "gyro", np.ma.array(RATES, mask=mask), "rad/s")
    return folder / "a.nc"


@dialect("netCDF4", dated=True, kept=~GONE)
def nc_missing_value(folder: Path) -> Path:
    acc, rate = ACC.copy(), RATES.copy()
    acc[GONE], rate[GONE] = 999.0, 999.0
    with nc(folder) as data:
        put(data, "accel", acc, "m/s2").missing_value = 999.0
        put(data, "gyro", rate, "rad/s").missing_value = 999.0
    return folder / "a.nc"


@dialect("netCDF4", dated=True, kept=~GONE)
def nc_valid_range(folder: Path) -> Path:
    acc, rate = ACC.copy(), RATES.copy()
    acc[GONE], rate[GONE] = 500.0, 500.0
    with nc(folder) as data:
        put(data, "accel", acc, "m/s2").valid_range = np.array([-160.0, 160.0])
        put(data, "gyro", rate, "rad/s").valid_max = 40.0
    return folder / "a.nc"


@dialect("netCDF4", dated=True)
def nc_hours_since(folder: Path) -> Path:
    with nc(folder) as data:
        data["time"].units = "hours since 2023-11-14 12:00:00"
        data["time"][:] = (START + T - 1_699_963_200) / 3600.0
        put(data, "accel", ACC, "m/s2")
        put(data, "gyro", RATES, "rad/s")
    return folder / "a.nc"


@dialect("netCDF4", dated=True)
def nc_big_endian(folder: Path) -> Path:
    with nc(folder) as data:
        put(data, "accel", ACC, "m/s2", endian="big")
        put(data, "gyro", RATES, "rad/s", endian="big")
    return folder / "a.nc"


@dialect("netCDF4", expected="told", dated=True)
def nc_compound(folder: Path) -> Path:
    kind = np.dtype([(f"{q}_{a}", "f8") for q in ("acc", "gyro") for a in "xyz"])
    rows = np.empty(N, kind)
    for name, column in zip(kind.names, [*ACC.T, *RATES.T], strict=True):
        rows[name] = column
    with nc(folder) as data:
        data.createVariable("imu", data.createCompoundType(kind, "imu_t"), ("time",))[:] = rows
    return folder / "a.nc"


@dialect("netCDF4", dated=True)
def nc_named_by_attributes(folder: Path) -> Path:
    with nc(folder) as data:
        put(data, "specific_force", ACC, "m s-2").long_name = "specific force"
        put(data, "rotation_rate", RATES, "radian s-1").long_name = "rate of rotation"
    return folder / "a.nc"


@dialect("netCDF4", expected="refused")
def nc_classic_64bit(folder: Path) -> Path:
    from netCDF4 import Dataset

    with Dataset(folder / "a.nc", "w", format="NETCDF3_64BIT_OFFSET") as data:
        data.createDimension("time", N)
        data.createDimension("axis", 3)
        put(data, "accel", ACC, "m/s2")
    return folder / "a.nc"
