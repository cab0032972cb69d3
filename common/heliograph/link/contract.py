"""What a modulation offers: how to send, how to receive one track, and when a frame is an identity.

A modulation is one file in `link/modulations/` and one row of `link/modulations/__init__.py`. Its receiver sees the
events of one track's region (time and polarity; the decoder has taken the pixels away) and decides frames.
Splitting the input anywhere changes nothing: `feed(a); feed(b)` yields what `feed(a + b)` yields.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import msgspec
import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusals
from heliograph.events import Flags, Times

Bits = tuple[int, ...]
Verdict = Literal["new", "valid", "invalid"]


class LinkFrame(msgspec.Struct, frozen=True):
    """A frame decided on its own bits (K = 1).

    Args:
        t_us: camera time at which its last bit ended.
        payload: its data bits, first on the air = most significant.
        score: 0 to 1, the confidence from its own bits.
        margin: log-likelihood (nats) to the runner-up.
    """

    t_us: int
    payload: int
    score: float
    margin: float


class Identity(msgspec.Struct, frozen=True):
    """What a track is, as far as its frames tell; a state that the receiver holds.

    Args:
        payload: the beacon's ID, or None where the protocol carries text (identity then means: a text beacon).
        since_us: end of the frame with which it was accepted.
        t_us: end of the newest frame that supports it.
        frames_used: how many frames it rests on.
        margin: their summed log-likelihood to the runner-up.
        confidence: 0 to 1, calibrated.
    """

    payload: int | None
    since_us: int
    t_us: int
    frames_used: int
    margin: float
    confidence: float


@dataclass(frozen=True, slots=True)
class Text:
    """Data released for the reader: everything held back has passed the identification rule.

    Args:
        t_us: end of what carried it.
        text: characters, or
        data: bytes.
        whole: a message by itself, never joined with another; otherwise a piece of a stream.
    """

    t_us: int
    text: str | None
    data: bytes | None
    whole: bool = False


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """The last second of a link; None where not known. How near to the truth: docs/protocols.md.

    Args:
        bit_rate: measured, bits a second.
        snr_db: 10 log10 of a transition's events over what noise puts in its place. Receivers know noise by different
            means (a background, one event, overdispersion): compare lights of one protocol.
        jitter_us: standard deviation of a transition's time against the clock.
        clock_ppm: how much faster than nominal the light's clock runs.
        events_per_transition: mean of the second's transitions.
        mar_estimate: frames accepted / frames decided or refused; what was wrong and passed, and what was never heard,
            is not in it, so it is at or above the true MAR.
    """

    bit_rate: float
    snr_db: float | None
    jitter_us: float | None
    clock_ppm: float | None
    events_per_transition: float | None
    mar_estimate: float | None


class Receiver(Protocol):
    """The demodulator of one track."""

    refusals: Refusals  # since the start; the decoder publishes the differences

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take the track's events, in order of time, all of those before until_us; return what they decide, in order.

        Args:
            t_us: (n,) int64, not falling, none before the previous until_us.
            on: (n,) bool.
            until_us: there are no more events before this time; not falling.
        """
        ...

    def flush(self) -> list[LinkFrame | Text]:
        """Decide what is still held: the stream has ended."""
        ...

    def identity(self) -> Identity | None:
        """Return the accepted identity, or None."""
        ...

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us: new, valid, or invalid (to be given up)."""
        ...

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read."""
        ...


@runtime_checkable
class Punctual(Protocol):
    """A receiver that knows when it is worth feeding; whoever does not heed it gets the same, later or at more cost."""

    def due_us(self) -> int:
        """Return the least until_us whose feed may decide a frame, as far as is known now; 2**60 if no time is."""
        ...


class Modulation(Protocol):
    """One way to send data by light; made with the options of its site's beacons."""

    name: str

    def encode(self, payload: Any) -> Bits:
        """Return the bits of one frame (of one text), first on the air first.

        Raises:
            ValueError: the payload cannot be sent; the text names the reason (and the twin, where it has one).
        """
        ...

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track.

        Args:
            bit_rate: nominal bits a second.
            name: "default", or another of this modulation's receivers ("paper", "binning", "wang2022").

        Raises:
            ValueError: this modulation has no such receiver.
        """
        ...


def edges_of(
    bits: Iterable[int], t0_us: float, bit_us: float, level: bool = False
) -> tuple[npt.NDArray[np.float64], Flags]:
    """Return times (float64 us) and new levels of the LED's changes while it sends the bits from t0_us on.

    Args:
        bits: 0 (dark) and 1 (lit).
        t0_us: beginning of the first bit.
        bit_us: length of a bit.
        level: the LED's state before the first bit.
    """
    levels = np.fromiter(bits, dtype=np.bool_)
    before = np.concatenate([np.array([level], np.bool_), levels[:-1]]) if len(levels) else levels
    at = np.flatnonzero(levels != before)
    return np.asarray(t0_us + at * bit_us, np.float64), levels[at]
