"""Settings of the beacon controller; each default with its reason."""

from __future__ import annotations

import re
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from heliograph.errors import ConfigError
from heliograph.site import Beacon
from heliograph.units import BIT_RATE_MAX, BIT_RATE_MIN

# usb:VVVV:PPPP or usb:VVVV:PPPP:SERIAL; anything else is what pyserial opens: a device, or a URL.
USB: Final = re.compile(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.{1,64}))?")

_Rate = Annotated[float, Meta(ge=BIT_RATE_MIN, le=BIT_RATE_MAX)]


class BeaconControllerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an operator may set.

    Raises:
        ConfigError: a port is no port, the limits of a range are the wrong way round, or a beacon's uid is given twice.
    """

    ports: Annotated[
        tuple[Annotated[str, Meta(min_length=1, max_length=200)], ...],
        Meta(description="where beacons are looked for: devices, URLs (socket://HOST:PORT), usb:VID:PID[:SERIAL]"),
    ] = ()
    # What ESP32 boards are flashed and talked to at by default.
    baud: Annotated[int, Meta(ge=1_200, le=4_000_000, description="baud rate of the serial lines")] = 115_200
    # With 5 % bad bytes a try of a command and its reply succeeds in one of three: 3 s are a hundred tries.
    deadline_s: Annotated[float, Meta(ge=0.1, le=60.0, description="a command that has not come through ends")] = 3.0
    # A reboot whose announcement was lost is seen by the next answer; a fifth of a second leaves most of the second in
    # which a beacon is to be as desired again.
    poll_s: Annotated[float, Meta(ge=0.05, le=60.0, description="how often a quiet beacon is asked how it is")] = 0.2
    # An unplugged port costs a failed open each time: 0.1 ms.
    reopen_s: Annotated[float, Meta(ge=0.02, le=60.0, description="how often a port that has gone is tried")] = 0.1
    # A beacon boots in a second and prints what is no protocol; on a line with 5 % bad bytes who it is has come through
    # after 5 s but once in a million times. A modem on the same USB chip is left in peace.
    nonsense_s: Annotated[
        float, Meta(ge=0.5, le=600.0, description="a port on which nothing sensible came for so long is left alone")
    ] = 5.0
    apply_site: Annotated[
        bool, Meta(description="give beacons the site's protocol, payload and bit rate; else take theirs as desired")
    ] = True

    # Authorisation
    secret_file: Annotated[
        str, Meta(max_length=4096, description="file with the secret that signs commands; empty: none is asked for")
    ] = ""
    # The largest command is a text of 4096 characters; a beacon queues less.
    command_bytes: Annotated[int, Meta(ge=256, le=65_536, description="bytes of a command on the bus, at most")] = 8_192
    # A person types one in a second; a program that sends ten a second for ever is broken.
    commands_hz: Annotated[float, Meta(ge=0.1, le=10_000.0, description="commands a second and beacon, lasting")] = 10.0
    commands_burst: Annotated[int, Meta(ge=1, le=10_000, description="commands at once before that limit bites")] = 20
    # Clocks of two hosts may differ by seconds; what lives longer would have to be remembered longer.
    expiry_max_s: Annotated[float, Meta(ge=1.0, le=600.0, description="how far ahead a command may expire")] = 60.0
    # Hosts on one network agree to 0.1 s. For so long a controller that has just started refuses every command: it
    # cannot tell one of now from one that was recorded before it started.
    clock_ahead_s: Annotated[
        float, Meta(ge=0.0, le=60.0, description="how far ahead of the controller's a sender's clock may be")
    ] = 1.0
    # A working day: a beacon that is forgotten goes dark by itself.
    lease_max_s: Annotated[float, Meta(ge=1.0, le=1e6, description="longest lease that may be asked for")] = 43_200.0
    # The paper's outdoor beacons blink at 1 kHz, the fastest at 5 kHz.
    bit_rate_min: Annotated[_Rate, Meta(description="slowest bit rate that may be set, bit/s")] = 50.0
    bit_rate_max: Annotated[_Rate, Meta(description="fastest bit rate that may be set, bit/s")] = 5_000.0
    power_max: Annotated[float, Meta(ge=0.0, le=1.0, description="share of the full light that may be set")] = 1.0

    # Closed loop
    adapt: Annotated[bool, Meta(description="choose the bit rate by how well the decoder reads the beacon")] = False
    adapt_min: Annotated[_Rate, Meta(description="slowest bit rate of the closed loop, bit/s")] = 250.0
    adapt_max: Annotated[_Rate, Meta(description="fastest bit rate of the closed loop, bit/s")] = 2_000.0

    beacons: Annotated[tuple[Beacon, ...], Meta(description="the site's beacons; those with a uid are kept")] = ()

    def __post_init__(self) -> None:
        for port in self.ports:
            if port.startswith("usb:") and not USB.fullmatch(port):
                raise ConfigError(f"port must look like usb:303a:1001 or usb:303a:1001:SERIAL, not {port!r}")
        twice = sorted({port for port in self.ports if self.ports.count(port) > 1})
        if twice:
            raise ConfigError(f"ports must differ, not twice {twice[0]}")
        for low, high in (("bit_rate_min", "bit_rate_max"), ("adapt_min", "adapt_max")):
            if getattr(self, low) > getattr(self, high):
                raise ConfigError(f"{low} must be at most {high} = {getattr(self, high):g}, not {getattr(self, low):g}")
        if self.adapt and not (self.bit_rate_min <= self.adapt_min and self.adapt_max <= self.bit_rate_max):
            raise ConfigError(
                f"adapt_min and adapt_max must lie in [{self.bit_rate_min:g}, {self.bit_rate_max:g}] bit/s,"
                f" not [{self.adapt_min:g}, {self.adapt_max:g}]"
            )
        uids = [beacon.uid.lower() for beacon in self.beacons if beacon.uid]
        twins = sorted({uid for uid in uids if uids.count(uid) > 1})
        if twins:
            raise ConfigError(f"beacons must have different uids, not twice {twins[0]}")
