"""Whether the extra `forecast` is there, without importing it."""

from importlib.util import find_spec

from netconvert.errors import ConfigError


def check_torch() -> None:
    """Errors: ConfigError where torch is not installed, with what to install."""
    if find_spec("torch") is None:
        raise ConfigError(
            "the small forecaster needs the extra `forecast` (torch): run `sh setup.sh forecast` in the checkout, "
            "or install torch into this environment"
        )
