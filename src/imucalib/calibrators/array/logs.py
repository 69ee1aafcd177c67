"""One array, several logs: do they agree within what each of them states?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.run import ArrayRun
from imucalib.errors import UsageError


@dataclass(frozen=True)
class Repeatability:
    """mean, sd : (A, 3) m, pooled by the inverse covariances; between : (A, 3) m, standard
    deviation over the logs; z_rms : of the logs' deviations from the pooled, in their stated sds;
    inflation : factor on the stated sds that the scatter asks for, at least 1"""

    mean: Array
    sd: Array
    between: Array
    z_rms: float
    inflation: float


def repeatability(runs: tuple[ArrayRun, ...]) -> Repeatability:
    """Pool the posteriors of two or more logs of one board."""
    if len(runs) < 2 or len({run.board.imus for run in runs}) > 1:
        raise UsageError("repeatability needs two or more logs of one board")
    means = np.array([run.final.mean[1:].ravel() for run in runs])
    precisions = [np.linalg.inv(run.final.covariance) for run in runs]
    covariance = np.linalg.inv(np.sum(precisions, axis=0))
    terms = [p @ m for p, m in zip(precisions, means, strict=True)]
    pooled = covariance @ np.sum(terms, axis=0)
    stated = np.array([run.final.sd[1:].ravel() for run in runs])
    # A log's deviation from the pooled value varies less than the log itself does.
    variance = stated**2 - np.diag(covariance)
    z = (means - pooled) / np.sqrt(np.maximum(variance, 1e-3 * stated**2))
    z_rms = float(np.sqrt(np.mean(z * z)))

    def shaped(values: Array) -> Array:
        return np.concatenate([np.zeros((1, 3)), values.reshape(-1, 3)])

    return Repeatability(
        shaped(pooled), shaped(np.sqrt(np.diag(covariance))), shaped(means.std(axis=0, ddof=1)),
        z_rms, max(1.0, z_rms),
    )  # fmt: skip
