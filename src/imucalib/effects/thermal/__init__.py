"""What of the temperature's past a bias may follow."""

from collections.abc import Callable

from imucalib.core.effect import Context


def values_of(prefix: str) -> Callable[[Context], tuple[str, ...]]:
    """What a scan tries: every covariate of this kind that the data carry, without the prefix."""
    return lambda context: tuple(
        name.removeprefix(prefix) for name in context.covariates if name.startswith(prefix)
    )
