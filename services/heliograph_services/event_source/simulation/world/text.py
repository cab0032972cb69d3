"""How a beacon's text becomes frames: a frame a character, or the protocol's own messages, a line each."""

from __future__ import annotations

from typing import Any

from heliograph.link.contract import Bits
from heliograph_services.event_source.simulation.world.spec import BeaconSpec


def frames_of_text(kind: Any, spec: BeaconSpec) -> list[tuple[int, Bits]]:
    """Return payload and bits of the frames of a beacon's text.

    Args:
        kind: its modulation; `messages(text, address)`, where it has it, takes the whole text.
        spec: the beacon, which has a text.

    Raises:
        ValueError: the modulation cannot send it, or has no address for the payload.
        TypeError: it sends no text.
    """
    text = spec.text or ""
    messages = getattr(kind, "messages", None)
    if messages is not None:
        frames: list[tuple[int, Bits]] = messages(text, spec.payload or 0)
        return frames
    if spec.payload is not None:
        raise ValueError(f"a beacon of {spec.protocol} must have one of payload, text")
    return [(ord(character), kind.encode(character)) for character in text]
