"""What a bias adds over temperature, as the polynomials of flight controllers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.core.effect import Context

#: Powers that the controllers hold, and temperatures at which a law is read.
_POWERS, _TEMPERATURES = 3, 25


@dataclass(frozen=True)
class Thermal:
    """What a reading without force and rate has beyond that at `middle`, Σ_k c_k (T - middle)^k for
    T from `low` to `high`, °C.

    force : (3, 3) m/s² per °C^k, powers 1 to 3 by axis; rate : the same in rad/s, or None
    """

    low: float
    high: float
    middle: float
    force: Array
    rate: Array | None

    def before(self, force: Iterable[float], rate: Iterable[float]) -> Thermal:
        """The same of readings that are multiplied by these, (3,) or (1,), afterwards."""
        powers = None if self.rate is None else self.rate / np.array([*rate])
        return replace(self, force=self.force / np.array([*force]), rate=powers)

    def about(self, reference: float) -> tuple[Array, Array | None]:
        """The same powers (3, 3) about another temperature, without what is constant: differences
        of two temperatures are the same."""
        shift = self.middle - reference
        # (x - s)^k in powers of x, both from 1 on.
        turn = np.array(
            [
                [1.0, -2.0 * shift, 3.0 * shift**2],
                [0.0, 1.0, -3.0 * shift],
                [0.0, 0.0, 1.0],
            ]
        )
        return turn @ self.force, None if self.rate is None else turn @ self.rate


def thermal_of(calibration: Calibration) -> Thermal | None:
    """The polynomials nearest to a calibration's laws, or None where nothing follows the
    temperature."""
    low, high = calibration.valid.get("temperature", (0.0, 0.0))
    model, theta = calibration.model()
    gyro = gyroscope_of(calibration)
    warm = np.linspace(low, high, _TEMPERATURES)
    if high <= low:
        return None
    known = calibration.context(warm.size).covariates
    context = Context(warm.size, {**known, "temperature": warm})
    nothing = np.zeros((warm.size, 1, 3))
    read = model.predict(theta, nothing, context).reading[:, 0]
    added = (
        np.zeros((0, 3)) if gyro is None else gyro.evaluate_laws(nothing[:, 0], nothing[:, 0], warm)
    )
    if max(float(np.ptp(one, axis=0).max()) for one in (read, added) if len(one)) <= 0.0:
        return None
    middle = 0.5 * (low + high)
    rate = None if gyro is None else _powers(warm - middle, added)
    return Thermal(low, high, middle, _powers(warm - middle, read), rate)


def _powers(warm: Array, read: Array) -> Array:
    """(3, 3) coefficients of powers of warm (n,) of numbers (n, 3)."""
    columns = np.vander(warm, _POWERS + 1, increasing=True)
    unit = np.abs(columns).max(axis=0)
    found = np.linalg.lstsq(columns / unit, read, rcond=None)[0] / unit[:, None]
    return np.asarray(found[1:])
