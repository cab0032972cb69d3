"""What makes lights bright and dark: beacons with their frames, lamps and blinkers, edges from outside."""

from __future__ import annotations

from typing import Any, Final

from heliograph.errors import ConfigError
from heliograph.link.contract import Bits as FrameBits
from heliograph.link.modulations import modulation
from heliograph.units import US_PER_S
from heliograph_services.event_source.simulation.contract import Drive
from heliograph_services.event_source.simulation.lights.beacon import BeaconDrive, Rounds
from heliograph_services.event_source.simulation.lights.clutter import (
    BitsDrive,
    TelegraphDrive,
    lamp,
    pwm,
    steady,
)
from heliograph_services.event_source.simulation.lights.recorded import open_edges
from heliograph_services.event_source.simulation.world.spec import (
    BeaconSpec,
    Bits,
    ClutterSpec,
    Glint,
    Lamp,
    Pwm,
    Signal,
    Steady,
    Telegraph,
)
from heliograph_services.event_source.simulation.world.text import frames_of_text

# Fresh payloads are drawn from the first so many of a modulation: more than any codebook of ours has.
PAYLOADS_TRIED: Final = 1024
# Where payloads are texts: the printable characters, space to tilde.
CHARACTERS: Final = range(0x20, 0x7F)


def drive_of(spec: BeaconSpec | ClutterSpec, seed: int, index: int) -> Drive:
    """Return what makes a light bright and dark.

    Args:
        spec: the light.
        seed: of the simulation.
        index: of the light's emitter in the world: beacons first, then clutter.

    Raises:
        ConfigError: a beacon's protocol does not exist, or cannot send what it is to send.
        FileError: its file of edges cannot be read, or is none.
    """
    try:
        if isinstance(spec, ClutterSpec):
            return _clutter(spec.signal, seed, index)
        if spec.edges:
            return open_edges(spec.edges)
        return BeaconDrive(
            _rounds(spec),
            spec.bit_rate,
            start_us=spec.start_us,
            clock_ppm=spec.clock_ppm,
            jitter_us=spec.jitter_us,
            seed=seed,
            index=index,
        )
    except ValueError as error:
        kind = "beacon" if isinstance(spec, BeaconSpec) else "clutter"
        raise ConfigError(f"{kind} {spec.name}: {error}") from None


def safe_frames(kind: Any) -> list[tuple[int, FrameBits]]:
    """Return payload and bits of the frames that a modulation can send and does not advise against.

    Of the first PAYLOADS_TRIED numbers; where a modulation sends texts, of the printable characters.

    Args:
        kind: a modulation (`heliograph.link.contract.Modulation`); its `advice`, where it has one, is heard.
    """
    advice = getattr(kind, "advice", None)
    frames: list[tuple[int, FrameBits]] = []
    for payload in range(PAYLOADS_TRIED):
        bits = _tried(kind, payload)
        if bits and (advice is None or advice(payload) is None):
            frames.append((payload, bits))
    if frames:
        return frames
    return [(code, bits) for code in CHARACTERS if (bits := _tried(kind, chr(code)))]


def _tried(kind: Any, payload: int | str) -> FrameBits:
    """Return a frame's bits; none where the modulation cannot send it."""
    try:
        bits: FrameBits = kind.encode(payload)
    except (ValueError, TypeError):
        return ()
    return bits


def _rounds(spec: BeaconSpec) -> Rounds:
    kind: Any = modulation(spec.protocol, **spec.options)
    if spec.fresh:
        return Rounds.drawn(safe_frames(kind), spec.gap_bits)
    try:
        if spec.text is not None:
            frames = frames_of_text(kind, spec)
        else:
            frames = [(int(spec.payload or 0), kind.encode(spec.payload))]
    except TypeError as error:
        what = "payload" if spec.text is None else "text"
        sent = spec.payload if spec.text is None else spec.text
        raise ValueError(f"protocol {spec.protocol} cannot send the {what} {sent!r}: {error}") from None
    return Rounds.repeated(frames, spec.gap_bits)


def _clutter(signal: Signal, seed: int, index: int) -> Drive:
    match signal:
        case Bits():
            return BitsDrive(signal.bit_rate, seed, index)
        case Telegraph():
            return TelegraphDrive(signal.mean_on_s * US_PER_S, signal.mean_off_s * US_PER_S, seed, index)
        case Glint():
            return TelegraphDrive(signal.mean_us, US_PER_S / signal.rate_hz, seed, index)
        case Pwm():
            return pwm(signal.frequency_hz, signal.duty, seed, index)
        case Lamp():
            return lamp(signal.frequency_hz, signal.depth, seed, index)
        case Steady():
            return steady(index)
