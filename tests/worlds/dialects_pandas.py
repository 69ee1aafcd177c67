"""Tables as pandas writes them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from worlds.dialects import ACC, DEG, RATES, START, TEMPERATURE, G, N, T, dialect

BOTH = {
    "force": {"left": ACC, "right": -ACC},
    "turn": {"left": RATES, "right": 2 * RATES},
}
NAMES = [f"acc_{a}" for a in "xyz"], [f"gyro_{a}" for a in "xyz"]


def frame(acc=ACC, rate=RATES, names=NAMES, index=None):
    import pandas as pd

    values = dict(zip([*names[0], *names[1]], [*acc.T, *rate.T], strict=True))
    return pd.DataFrame(values, index=index)


def dates(tz=None):
    import pandas as pd

    return pd.to_datetime(START * 10**9 + np.arange(N) * 10_000_000, utc=tz is not None).rename(
        "time"
    )


def timed(**more):
    f = frame(**more)
    f.insert(0, "time", T)
    return f


RAD = ([f"acc_{a} [m/s^2]" for a in "xyz"], [f"gyro_{a} [rad/s]" for a in "xyz"])


@dialect("pandas")
def index_false(folder: Path) -> Path:
    timed(names=RAD).to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas")
def range_index(folder: Path) -> Path:
    timed(names=RAD).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def datetime_index(folder: Path) -> Path:
    frame(names=RAD, index=dates()).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def datetime_index_without_name(folder: Path) -> Path:
    frame(names=RAD, index=dates().rename(None)).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def datetime_index_utc(folder: Path) -> Path:
    frame(names=RAD, index=dates(tz="UTC")).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def datetime_index_berlin(folder: Path) -> Path:
    frame(names=RAD, index=dates(tz="UTC").tz_convert("Europe/Berlin")).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", expected="refused")
def timedelta_index(folder: Path) -> Path:
    import pandas as pd

    index = pd.to_timedelta(np.arange(N) * 10, unit="ms").rename("time")
    frame(names=RAD, index=index).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def german_dates(folder: Path) -> Path:
    f = frame(names=RAD, index=dates())
    f.to_csv(folder / "a.csv", date_format="%d.%m.%Y %H:%M:%S.%f", sep=";", decimal=",")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def american_dates_am_pm(folder: Path) -> Path:
    f = frame(names=RAD, index=dates())
    f.to_csv(folder / "a.csv", date_format="%m/%d/%Y %I:%M:%S.%f %p")
    return folder / "a.csv"


@dialect("pandas")
def float_index(folder: Path) -> Path:
    import pandas as pd

    frame(names=RAD, index=pd.Index(T, name="t")).to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", dated=True)
def epoch_ms(folder: Path) -> Path:
    f = frame(names=RAD)
    f.insert(0, "timestamp_ms", START * 1000 + np.arange(N) * 10)
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", dated=True)
def epoch_ns_last(folder: Path) -> Path:
    f = frame(names=RAD)
    f["stamp"] = START * 10**9 + np.arange(N) * 10_000_000
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", expected="told", dated=True)
def epoch_s_scientific(folder: Path) -> Path:
    f = frame(names=RAD)
    f.insert(0, "time", START + T)
    f.to_csv(folder / "a.csv", index=False, float_format="%.10e")
    return folder / "a.csv"


def multi(order="xyz", levels=("acc", "gyro")):
    import pandas as pd

    columns = pd.MultiIndex.from_product([levels, list(order)])
    at = ["xyz".index(a) for a in order]
    values = np.column_stack([ACC[:, at], RATES[:, at]])
    return pd.DataFrame(values, columns=columns, index=pd.Index(T, name="time"))


@dialect("pandas", expected="told")
def multiindex(folder: Path) -> Path:
    multi().to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", expected="told")
def multiindex_zyx(folder: Path) -> Path:
    multi("zyx").to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect("pandas", expected="told")
def multiindex_named_levels(folder: Path) -> Path:
    f = multi("yxz", ("specific_force", "rotation_rate"))
    f.columns.names = ["quantity", "axis"]
    f.to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect(
    "pandas",
    expected="told",
    force={"left": ACC, "right": -ACC},
    turn={"left": RATES, "right": 2 * RATES},
)
def multiindex_three_levels(folder: Path) -> Path:
    import pandas as pd

    columns = pd.MultiIndex.from_product([["left", "right"], ["acc", "gyro"], list("xyz")])
    values = np.column_stack([ACC, RATES, -ACC, 2 * RATES])
    f = pd.DataFrame(values, columns=columns, index=pd.Index(T, name="time"))
    f.to_csv(folder / "a.csv")
    return folder / "a.csv"


@dialect(
    "pandas",
    expected="told",
    force={"left": ACC, "right": -ACC},
    turn={"left": RATES, "right": 2 * RATES},
)
def two_sensors_by_suffix(folder: Path) -> Path:
    one, two = timed().add_suffix("_left"), frame(-ACC, 2 * RATES).add_suffix("_right")
    f = one.rename(columns={"time_left": "time"}).join(two)
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


#: What `to_csv` writes otherwise: the file and its options.
PLAIN = {
    "german_decimal": ("a.csv", dict(sep=";", decimal=",")),
    "tabs": ("a.tsv", dict(sep="\t")),
    "pipes": ("a.txt", dict(sep="|")),
    "quoted": ("a.csv", dict(quoting=csv.QUOTE_ALL)),
    "quoted_words": ("a.csv", dict(quoting=csv.QUOTE_NONNUMERIC)),
    "utf16": ("a.csv", dict(encoding="utf-16")),
    "utf8_with_mark": ("a.csv", dict(encoding="utf-8-sig")),
    "windows_lines_gzip": ("a.csv.gz", dict(lineterminator="\r\n")),
}


def plain(name: str, **options):
    def write(folder: Path) -> Path:
        timed(names=RAD).to_csv(folder / name, index=False, **options)
        return folder / name

    return write


for _name, (_file, _options) in PLAIN.items():
    _write = plain(_file, **_options)
    _write.__name__ = _name
    dialect("pandas")(_write)


@dialect("pandas", resolution=6e-4)
def three_decimals(folder: Path) -> Path:
    timed(names=RAD).to_csv(folder / "a.csv", float_format="%.3f", index=False)
    return folder / "a.csv"


@dialect("pandas", resolution=1e-6)
def g_and_dps(folder: Path) -> Path:
    names = ([f"acc_{a} (g)" for a in "xyz"], [f"gyro_{a} (deg/s)" for a in "xyz"])
    timed(acc=ACC / G, rate=RATES / DEG, names=names).to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", resolution=1e-6)
def mg_and_mdps_joined(folder: Path) -> Path:
    names = ([f"acc_{a}_mg" for a in "xyz"], [f"gyro_{a}_mdps" for a in "xyz"])
    f = timed(acc=ACC / G * 1e3, rate=RATES / DEG * 1e3, names=names)
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


GONE = np.isin(np.arange(N), [3, 200, 201, 500])


def holes(**options):
    def write(folder: Path) -> Path:
        f = timed(names=RAD)
        f.loc[GONE, RAD[0]] = np.nan
        f.loc[GONE, RAD[1]] = np.nan
        f.to_csv(folder / "a.csv", index=False, **options)
        return folder / "a.csv"

    return write


for _name, _mark in (("empty", ""), ("nan", "NaN"), ("null", "NULL"), ("code", "-9999"),
                     ("na_in_brackets", "<NA>"), ("dash", "-")):  # fmt: skip
    _write = holes(na_rep=_mark)
    _write.__name__ = f"missing_{_name}"
    dialect("pandas", kept=~GONE)(_write)


@dialect("pandas")
def with_text_and_flags(folder: Path) -> Path:
    f = timed(names=RAD)
    f["label"], f["moving"], f["count"] = "walk", True, np.arange(N)
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas")
def temperature_between(folder: Path) -> Path:
    f = timed(names=RAD)
    f.insert(4, "temperature (°C)", TEMPERATURE)
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas")
def columns_mixed(folder: Path) -> Path:
    f = timed(names=RAD)
    f[sorted(f.columns, key=lambda c: c[::-1])].to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", expected="refused")
def rows_reversed(folder: Path) -> Path:
    timed(names=RAD)[::-1].to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", expected="refused")
def long_form(folder: Path) -> Path:
    f = timed(names=RAD).melt(id_vars="time", var_name="channel")
    f.sort_values(["time", "channel"]).to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", expected="refused")
def sensors_in_rows(folder: Path) -> Path:
    import pandas as pd

    f = pd.concat([timed().assign(id=k) for k in (1, 2)]).sort_values(["time", "id"])
    f.to_csv(folder / "a.csv", index=False)
    return folder / "a.csv"


@dialect("pandas", expected="told")
def to_string(folder: Path) -> Path:
    (folder / "a.txt").write_text(timed(names=NAMES).to_string(index=False) + "\n")
    return folder / "a.txt"


@dialect("pandas", expected="refused")
def to_json(folder: Path) -> Path:
    timed().to_json(folder / "a.json", orient="records")
    return folder / "a.json"


@dialect("pandas", expected="refused")
def to_parquet(folder: Path) -> Path:
    timed().to_parquet(folder / "a.parquet")
    return folder / "a.parquet"


@dialect("tables", expected="refused")
def hdf_fixed(folder: Path) -> Path:
    timed().to_hdf(folder / "a.h5", key="log")
    return folder / "a.h5"


@dialect("tables", expected="refused")
def hdf_table(folder: Path) -> Path:
    timed().to_hdf(folder / "a.h5", key="log", format="table")
    return folder / "a.h5"


@dialect("tables", expected="told", force={"log": ACC}, turn={"log": RATES})
def hdf_data_columns(folder: Path) -> Path:
    timed().to_hdf(folder / "a.h5", key="log", format="table", data_columns=True)
    return folder / "a.h5"
