"""Whether the noise is as large as was declared."""

from __future__ import annotations

from imucalib.core.fit import Fit


def beyond_declared(fit: Fit) -> float:
    """Chance of a noise factor this far above 1 if the declared noise were true.

    Chi-square (upper tail), with as many degrees of freedom as the estimate of the factor is worth:
    settings that scatter take some away.
    """
    from scipy.special import chdtrc

    spread = float(fit.noise_covariance[0, 0])
    dof = 0.5 / spread if spread > 0.0 else float(fit.dof)
    return float(chdtrc(dof, dof * fit.noise.factor**2))
