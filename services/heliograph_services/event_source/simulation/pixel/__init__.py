"""The pixels: from light to events (`array.PixelArray`)."""


def warm() -> None:
    """Compile every kernel of the pixels, or load it from the cache."""
    from heliograph_services.event_source.simulation.pixel.array import warm as warm_array  # noqa: PLC0415  # numba

    warm_array()
