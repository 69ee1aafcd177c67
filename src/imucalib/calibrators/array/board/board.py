"""The drawing of an array: where its packages are, how they are turned, what they can measure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.recording.mapping import parse_axis_map
from imucalib.recording.pairing import fault
from imucalib.recording.yaml_text import load
from imucalib.units import DEG, STANDARD_GRAVITY

BOARDS = Path(__file__).parent / "boards"
_KEYS = ("name", "prior_sd", "accelerometer_range", "gyroscope_range", "package", "outline", "imus")
_IMU_KEYS = ("name", "position", "axes", "rotation", "accelerometer_axes", "gyro_axes")
FEWEST_IMUS = 2
_SMALLEST = 1e-4  # m that an array extends at least


@dataclass(frozen=True)
class Board:
    """The nominal geometry of K IMUs, in the board's frame.

    positions : (K, 3) m; rotations : (K, 3, 3), package axes to board axes
    prior_sd : m, of each coordinate about the drawing; undrawn : whether there is no drawing, and
        positions and rotations are still to come from a log
    accelerometer_range : m/s², gyroscope_range : rad/s, where readings clip; inf when not known
    package : m, its size or None
    accelerometer_axes, gyro_axes : (K, 3, 3) signed permutations, a sensor's own axes to the
        package's, where it is wired otherwise than the package is drawn
    """

    name: str
    imus: tuple[str, ...]
    positions: Array
    rotations: Array
    prior_sd: float = 3e-3
    undrawn: bool = False
    accelerometer_range: float = float("inf")
    gyroscope_range: float = float("inf")
    package: tuple[float, float, float] | None = None
    accelerometer_axes: Array = field(default_factory=lambda: np.eye(3)[None])
    gyro_axes: Array = field(default_factory=lambda: np.eye(3)[None])

    def __post_init__(self) -> None:
        for name in ("accelerometer_axes", "gyro_axes"):
            every = np.broadcast_to(getattr(self, name), self.rotations.shape)
            object.__setattr__(self, name, every)

    @property
    def count(self) -> int:
        return len(self.imus)

    @cached_property
    def drawn(self) -> Array:
        """(K, 3) m relative to the first IMU."""
        return np.asarray(self.positions - self.positions[0])


def board_names() -> tuple[str, ...]:
    """Names of the boards that come with the program."""
    return tuple(sorted(p.stem for p in BOARDS.glob("*.yaml")))


def read_board(name: str | Path) -> Board:
    """A board that comes with the program by name, a YAML file, or a number of IMUs.

    Raises UsageError for an unknown name, UnreadableInput with what is wrong in the file.
    """
    if str(name).isdigit():
        return undrawn_board(int(str(name)))
    path = BOARDS / f"{name}.yaml" if str(name) in board_names() else Path(name)
    if not path.is_file():
        raise UsageError(
            f"no board '{name}'",
            remedy=f"give a YAML file, or one of: {', '.join(board_names())}; or, without a "
            "drawing, how many IMUs there are",
        )
    content = load(path)
    try:
        return _board(content)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableInput(
            f"the board is incomplete: {error!r}",
            where=str(path),
            remedy="each entry of imus needs name, position [x, y, z] in mm, and axes",
        ) from None
    except ImucalError as error:
        raise UnreadableInput(error.what, where=str(path), remedy=error.remedy) from None


def _board(content: Mapping[str, Any]) -> Board:
    _refuse_unknown(content, _KEYS, "the board")
    imus = content["imus"]
    for imu in imus:
        _refuse_unknown(imu, _IMU_KEYS, str(imu["name"]))
    positions = np.array([imu["position"] for imu in imus], dtype=float).reshape(len(imus), 3)
    rotations = np.array([_rotation(imu) for imu in imus])
    names = tuple(str(imu["name"]) for imu in imus)
    for name in names:
        if wrong := fault(name):
            raise UnreadableInput(
                f"the name {name!a} of an IMU: {wrong}",
                remedy="letters, digits, / _ - . and spaces make a name",
            )
    if len(set(names)) < len(names) or len(names) < FEWEST_IMUS:
        raise UnreadableInput("an array has two or more IMUs of different names")
    if not np.isfinite(positions).all():
        raise UnreadableInput("a nominal position is not a number", remedy="three numbers in mm")
    extent = 1e-3 * float(np.ptp(positions, axis=0).max())
    if extent < _SMALLEST:
        raise UnreadableInput(
            f"the whole array extends {1e6 * extent:.3g} µm, its positions look like metres",
            remedy=f"the board file gives positions in mm; --board {len(names)} needs none",
        )
    package = tuple(float(v) * 1e-3 for v in content.get("package", ()))
    return Board(
        name=str(content.get("name", "array")),
        imus=names,
        positions=positions * 1e-3,
        rotations=rotations,
        prior_sd=float(content.get("prior_sd", 3.0)) * 1e-3,
        accelerometer_range=float(content.get("accelerometer_range", np.inf)) * STANDARD_GRAVITY,
        gyroscope_range=float(content.get("gyroscope_range", np.inf)) * DEG,
        package=(package[0], package[1], package[2]) if len(package) == 3 else None,
        accelerometer_axes=np.array([_axes(imu, "accelerometer_axes") for imu in imus]),
        gyro_axes=np.array([_axes(imu, "gyro_axes") for imu in imus]),
    )


def undrawn_board(count: int) -> Board:
    """So many IMUs without a drawing: all that a log cannot tell is where they are about."""
    if count < FEWEST_IMUS:
        raise UsageError("an array has two or more IMUs")
    return Board(
        name=f"{count} IMUs without a drawing",
        imus=tuple(f"imu{k}" for k in range(count)),
        positions=np.zeros((count, 3)),
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        undrawn=True,
    )


def _refuse_unknown(content: Mapping[str, Any], known: tuple[str, ...], whose: str) -> None:
    """A key that means nothing is a misspelt one: what it should say would be left out."""
    for key in content:
        if key not in known:
            near = get_close_matches(str(key), known, 1)
            meant = f"'{near[0]}'?" if near else f"known are {', '.join(known)}"
            raise UnreadableInput(f"{whose} has the unknown key '{key}'", remedy=meant)


def _axes(imu: Mapping[str, Any], key: str) -> Array:
    """(3, 3) the x, y and z that `key` names in terms of what is read."""
    chosen = parse_axis_map(str(imu.get(key, "")))
    turn = np.zeros((3, 3))
    turn[np.arange(3), list(chosen.order)] = chosen.sign
    return turn


def _rotation(imu: Mapping[str, Any]) -> Array:
    if "rotation" in imu:
        turn = np.array(imu["rotation"], dtype=float).reshape(3, 3)
    else:
        turn = _axes(imu, "axes")
    if np.linalg.norm(turn @ turn.T - np.eye(3)) > 1e-6 or np.linalg.det(turn) < 0.0:
        raise UnreadableInput(
            f"the axes of {imu['name']} are not a rotation",
            remedy="a right-handed set: an even number of swaps and sign changes",
        )
    return turn
