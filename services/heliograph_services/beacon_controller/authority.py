"""Who may tell a beacon what: checked here, whatever the router's rules let through.

A command is checked from the outside inwards, and the first thing that is wrong with it is why it is refused::

    the exact key of a listed beacon - size - envelope and schema - its name is the key's - the site's secret -
    not expired, and not living too long - not issued in the future, nor before the start - a nonce that was not
    used - not too frequent - within the site's limits

Nothing that fails before the secret costs the beacon's allowance. Nonces are remembered until their command has
expired, so that a replayed one is refused for one reason or the other; but not beyond the process. What a process took
at wall time t was issued at ``t + clock_ahead_s`` at the latest, and t lies before the start of the next process: so
that one refuses what was issued up to ``start + clock_ahead_s``, and need not know the nonces. (Where the controller's
own clock is set back between the two, this does not hold.) Time comes in with each check.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

from heliograph.beacons import BeaconCommand
from heliograph.errors import Refusal, Refusals
from heliograph.wire import Refused, unpack
from heliograph_services.beacon_controller.config import BeaconControllerConfig

_SCHEMAS: Final = {BeaconCommand.SCHEMA: BeaconCommand}
# Beyond the allowance of all beacons over the longest life there are no nonces; this bounds a wrong setting.
_NONCES_LIMIT: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Denied:
    """A command that is refused: why, and whose it was as far as it could be read."""

    reason: Refusal
    detail: str
    nonce: str = ""


class Authority:
    """Decides on commands.

    Args:
        config: the limits.
        secret: signs commands; empty where none is asked for.
        started_ms: Unix time at which this process began.
    """

    def __init__(self, config: BeaconControllerConfig, secret: bytes, started_ms: int) -> None:
        self.refusals: Refusals = Counter()
        self._config = config
        self._secret = secret
        self._clock_ahead_ms = round(config.clock_ahead_s * 1000)
        self._floor_ms = started_ms + self._clock_ahead_ms
        self._names = frozenset(beacon.name for beacon in config.beacons if beacon.uid)
        self._used: dict[str, int] = {}  # nonce -> when its command expires, ms; in the order of use
        self._allowance: dict[str, tuple[float, float]] = {}  # name -> commands left, as of

    def check(self, asked_key: str, own_key: str, payload: bytes, wall_ms: int, now_s: float) -> BeaconCommand | Denied:
        """Return the command of a query, or why there is none.

        Args:
            asked_key: the key expression as it was asked.
            own_key: the beacon's key.
            payload: the query's bytes.
            wall_ms: Unix time.
            now_s: a clock that only moves on.
        """
        outcome = self._check(asked_key, own_key, payload, wall_ms, now_s)
        if isinstance(outcome, Denied):
            self.refusals[outcome.reason] += 1
        return outcome

    def _check(
        self, asked_key: str, own_key: str, payload: bytes, wall_ms: int, now_s: float
    ) -> BeaconCommand | Denied:
        name = own_key.rsplit("/", 2)[-2]
        if asked_key != own_key or name not in self._names:
            return Denied(Refusal.NOT_EXACT, f"ask on {own_key}, not on {asked_key}"[:300])
        if len(payload) > self._config.command_bytes:
            return Denied(Refusal.TOO_LARGE, f"{len(payload)} bytes, at most {self._config.command_bytes}")
        opened = unpack(payload, dict(_SCHEMAS))
        if isinstance(opened, Refused):
            return Denied(opened.reason, opened.detail)
        command = opened[1]
        if not isinstance(command, BeaconCommand):  # the schemas given above allow nothing else
            return Denied(Refusal.UNKNOWN_SCHEMA, type(command).__name__)
        if command.name != name:
            return Denied(Refusal.WRONG_KEY, f"a command for {command.name} on the key of {name}", command.nonce)
        if not command.is_authentic(self._secret):
            return Denied(Refusal.NOT_AUTHENTIC, "its mac is not that of the site's secret", command.nonce)
        return self._fresh(command, wall_ms) or self._affordable(command, now_s) or self._allowed(command) or command

    def _fresh(self, command: BeaconCommand, wall_ms: int) -> Denied | None:
        ahead_ms = command.expires_ms - wall_ms
        if ahead_ms <= 0:
            return Denied(Refusal.EXPIRED, f"it expired {-ahead_ms / 1000:.3f} s ago", command.nonce)
        if ahead_ms > self._config.expiry_max_s * 1000:
            limit = f"at most {self._config.expiry_max_s:g} s ahead"
            return Denied(Refusal.EXPIRES_LATE, f"it expires in {ahead_ms / 1000:.3f} s, {limit}", command.nonce)
        early_ms = command.issued_ms - wall_ms
        if early_ms > self._clock_ahead_ms:
            limit = f"at most {self._config.clock_ahead_s:g} s"
            detail = f"its sender's clock is {early_ms / 1000:.3f} s ahead, {limit} may be"
            return Denied(Refusal.ISSUED_AHEAD, detail, command.nonce)
        if command.issued_ms <= self._floor_ms:
            detail = "the controller cannot know whether it was carried out before: issue it anew"
            return Denied(Refusal.ISSUED_BEFORE, detail, command.nonce)
        if command.nonce in self._used:
            return Denied(Refusal.REPLAYED, "a command with this nonce came before", command.nonce)
        self._forget(wall_ms)
        self._used[command.nonce] = command.expires_ms
        return None

    def _forget(self, wall_ms: int) -> None:
        # They expire nearly in the order of their use: the first that has not ends the search but for a full memory.
        for nonce in list(self._used)[:16]:
            if self._used[nonce] <= wall_ms:
                del self._used[nonce]
        while len(self._used) >= _NONCES_LIMIT:
            self._used.pop(next(iter(self._used)))

    def _affordable(self, command: BeaconCommand, now_s: float) -> Denied | None:
        config = self._config
        left, as_of_s = self._allowance.get(command.name, (float(config.commands_burst), now_s))
        left = min(float(config.commands_burst), left + (now_s - as_of_s) * config.commands_hz)
        if left < 1.0:
            self._allowance[command.name] = (left, now_s)
            limit = f"{config.commands_burst} at once and {config.commands_hz:g} a second"
            return Denied(Refusal.TOO_FREQUENT, f"more than {limit}", command.nonce)
        self._allowance[command.name] = (left - 1.0, now_s)
        return None

    def _allowed(self, command: BeaconCommand) -> Denied | None:
        config = self._config
        ranges = (
            ("bit_rate", command.bit_rate, config.bit_rate_min, config.bit_rate_max),
            ("power", command.power, 0.0, config.power_max),
            ("lease_s", command.lease_s, 0.0, config.lease_max_s),
        )
        for field, value, low, high in ranges:
            if value is not None and not low <= value <= high:
                detail = f"{field} must be in [{low:g}, {high:g}], not {value:g}"
                return Denied(Refusal.NOT_ALLOWED, detail, command.nonce)
        return None
