"""Failures a user can mend. Each message is one sentence: what was found, what was expected, what to do."""

from __future__ import annotations


class ExcavatwinError(Exception):
    """Root of every error that ExcavaTwin raises on purpose; the CLI prints it and exits with code 2."""


class InputError(ExcavatwinError, ValueError):
    """The photos, video, file or parameter that was given cannot be used as it is."""


class ObservationError(InputError):
    """An observations file breaks its contract; the message names the first thing that is wrong."""


class ReconstructionError(ExcavatwinError, RuntimeError):
    """The photos were readable but no trustworthy geometry came out of them."""


class OutputError(ExcavatwinError, OSError):
    """A result could not be written (read-only target, full disk); nothing half-written is left behind."""


class MissingExtraError(ExcavatwinError, ImportError):
    """An optional backbone is not installed; the message gives the exact install line."""


def require(owner: object, name: str, low: float, high: float = float("inf"), open_low: bool = False) -> None:
    """Refuse a parameter of a stage that lies outside its range; None (not given) passes.

    Args:
        owner: the stage.
        name: its field.
        low: least value; excluded when ``open_low``.
        high: greatest value.

    Raises:
        InputError: the value is outside, or not a number.
    """
    value = getattr(owner, name)
    if value is None or ((low < value if open_low else low <= value) and value <= high):
        return
    expected = f"more than {low:g}" if open_low else f"at least {low:g}"
    expected += f" and at most {high:g}" if high < float("inf") else ""
    raise InputError(f"{type(owner).__name__}.{name} is {value}; expected {expected}.")
