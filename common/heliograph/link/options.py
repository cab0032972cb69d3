"""Options of a modulation, which come from a site file or a command line: numbers, texts, or neither."""

from __future__ import annotations


def whole(what: str, value: object, low: int, high: int) -> int:
    """Return a whole number in [low, high].

    Args:
        what: of what, for the text of the error.
        value: as given.
        low: least that is allowed.
        high: most.

    Raises:
        ValueError: it is none, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{what} must be in [{low}, {high}], not {value!r}")
    return value
