"""The beacons that a site lists: shared by the site file, the decoder and the beacon controller."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from heliograph.messages import Name, Payload
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN


class Beacon(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One `[[beacon]]` of a site file.

    Args:
        name: what keys and identifications call it.
        uid: the hardware's own number, for the beacon controller.
        protocol: a row of `heliograph.link.modulations`.
        payload: its ID; None for a beacon that sends text.
        bit_rate: bits a second.
        options: the modulation's own settings, e.g. {"parity": "paper_text"} or {"codebook": "code20d4"}.
    """

    name: Name
    protocol: Name
    bit_rate: Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]
    payload: Payload | None = None
    uid: str = ""
    options: dict[str, str | int] = {}
