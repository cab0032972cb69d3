"""What is wanted of a beacon and what it says of itself, apart; and what to ask of it next so that the two agree.

A keeper opens nothing: it is asked for the next request when its line is free, and told the answer. In this order::

    1. what is not known: GET (the program), STATUS (the lease)
    2. what differs: SET, then ARM or DISARM
    3. the commands of the bus, in the order in which they came
    4. in silence, GET, and now and then STATUS: an answer of another boot is a reboot

A command that ends is `applied` when the beacon has said so, and only then does what it asked for become what is
wanted; but a beacon that is told to be dark is wanted dark from then on, whatever comes. After a reboot the beacon is
dark and knows at most what it saved: 2. brings it back. A message that was sent to the beacon before a reboot and not
confirmed has failed: to send it again might double it.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

import msgspec

from heliograph.beacons import BeaconCommand, BeaconReply, BeaconState, LinkWord, Settings
from heliograph.site import Beacon
from heliograph_services.beacon_controller.config import BeaconControllerConfig
from heliograph_services.beacon_controller.exchange import Request
from heliograph_services.beacon_controller.jobs import KIND_OF, Job, checked_program, lease_of, merged, message_of
from heliograph_services.beacon_controller.records import (
    LEASE_LIMIT_MS,
    WORDS,
    Hello,
    Kind,
    Program,
    Result,
    Status,
    program_for,
    program_of,
    status_of,
)

# Leases are counted here and there from moments that differ by what a command takes on a bad line.
_LEASE_SLACK_S: Final = 1.0
# A lease that is longer than the protocol's longest is renewed when half of that is left.
_RENEW_S: Final = LEASE_LIMIT_MS / 2000
# One poll in so many is a STATUS, the longest reply; the others are a GET.
_STATUS_EVERY: Final = 5
_JOBS_LIMIT: Final = 256


class Keeper:
    """One beacon of the site.

    Args:
        beacon: its name, uid, and what the site wants it to send.
        config: deadlines, and whether the site's wishes are applied.

    Raises:
        ValueError: the site wants it to send what no beacon can; names the value and the range.
    """

    def __init__(self, beacon: Beacon, config: BeaconControllerConfig) -> None:
        self.beacon = beacon
        self.uid = beacon.uid.lower()
        self.hello: Hello | None = None
        self.boot = 0
        self.port = ""
        self.counters: Counter[str] = Counter()
        self.trouble = ""
        self.replies: list[tuple[int, BeaconReply]] = []
        self._config = config
        self._desired = _wish_of(beacon) if config.apply_site else Settings()
        self._adopts = not config.apply_site or program_for(self._desired) is None
        self._lit_until_s = 0.0
        self._adopts_lease = True
        self._reported: Program | None = None
        self._reported_lit_s = 0.0
        self._has_spoken = False
        self._needs: list[Kind] = []
        self._declined: Program | None = None
        self._jobs: deque[Job] = deque()
        self._job: Job | None = None
        self._accepted = self._ended = 0
        self._polls = 0
        self._poll_s = 0.0

    # Its line

    def bound(self, port: str, hello: Hello | None, boot: int, now_s: float) -> None:
        """Take note that it has been found on a port."""
        self.port = port
        self.hello = hello or self.hello
        self._poll_s = now_s
        if boot != self.boot:
            if self.boot:
                self.rebooted(boot, now_s)
            else:
                self.boot = boot
                self._needs = [Kind.GET, Kind.STATUS]
        elif not self._needs:
            self._needs = [Kind.STATUS]

    def rebooted(self, boot: int, now_s: float) -> None:
        """Take note that all but its saved program is gone, and its light is dark."""
        self.boot = boot
        self.counters["boots"] += 1
        self._reported, self._reported_lit_s = None, 0.0
        self._declined = None
        self._accepted = self._ended = 0
        self._needs = []
        self._poll_s = now_s
        if self._adopts:
            self._needs = [Kind.GET]
        self.interrupted(now_s, "rebooted", "it rebooted before it had confirmed the message")

    def interrupted(self, now_s: float, reason: str, detail: str) -> None:
        """Give up the request under way: a message that may have arrived has failed, all else is asked again."""
        job, self._job = self._job, None
        if job is None:
            return
        if job.command.op == "send" and job.tries:
            self._finish(job, now_s, reason, detail)
        else:
            self._jobs.appendleft(job)

    # Commands

    def take(self, ticket: int, command: BeaconCommand, now_s: float) -> None:
        """Take a command of the bus."""
        job = Job(ticket, command, now_s, now_s + self._config.deadline_s)
        if command.op == "disarm":
            self._lit_until_s, self._adopts_lease = 0.0, False
        if len(self._jobs) >= _JOBS_LIMIT:
            self._finish(job, now_s, "declined", f"{_JOBS_LIMIT} commands wait already")
        else:
            self._jobs.append(job)

    @property
    def bit_rate(self) -> float | None:
        """What bit rate is wanted."""
        return self._desired.bit_rate

    def wanted_rate(self, bit_rate: float) -> None:
        """Want another bit rate, without a command (the closed loop)."""
        self._desired = msgspec.structs.replace(self._desired, bit_rate=bit_rate)

    def expire(self, now_s: float, link: LinkWord) -> None:
        """End the commands that wait in vain; the one under way ends with its request."""
        hopeless = link in {"nonsense", "foreign"}
        while self._jobs and (hopeless or now_s >= self._jobs[0].deadline_s):
            job = self._jobs.popleft()
            why = "it is left alone" if hopeless else f"nothing was confirmed in {self._config.deadline_s:g} s"
            self._finish(job, now_s, "no answer" if link == "ready" else link, why)

    @property
    def poll_s(self) -> float:
        """When it is to be asked how it is, unless there is something else to ask."""
        return self._poll_s

    @property
    def deadline_s(self) -> float:
        """When the first of its waiting commands has failed."""
        return self._jobs[0].deadline_s if self._jobs else float("inf")

    # What to ask next, and what was answered

    def next_request(self, now_s: float) -> Request | None:
        """Return what to ask of the beacon now, or None."""
        deadline_s = now_s + self._config.deadline_s
        if self._needs:
            return Request(self._needs[0], b"", deadline_s)
        correction = self._correction(now_s)
        if correction is not None:
            self.counters["corrections"] += 1
            return Request(*correction, deadline_s)
        while self._jobs:
            job = self._jobs.popleft()
            request = self._request_of(job, now_s)
            if request is not None:
                self._job = job
                return request
        if now_s < self._poll_s:
            return None
        self._polls += 1
        return Request(Kind.GET if self._polls % _STATUS_EVERY else Kind.STATUS, b"", deadline_s)

    def _correction(self, now_s: float) -> tuple[Kind, bytes] | None:
        wanted = self._wanted_program()
        if wanted is not None and wanted not in {self._reported, self._declined}:
            return Kind.SET, wanted.to_bytes()
        lit_s = self._reported_lit_s
        if self._lit_until_s > now_s and self._reported is not None:
            is_short = lit_s < self._lit_until_s - _LEASE_SLACK_S and lit_s - now_s < _RENEW_S
            if lit_s <= now_s or is_short:
                return Kind.ARM, lease_of(self._lit_until_s - now_s)
        elif lit_s > max(now_s, self._lit_until_s) + _LEASE_SLACK_S:
            return Kind.DISARM, b""
        return None

    def _wanted_program(self) -> Program | None:
        try:
            return checked_program(self._desired, self.hello)
        except ValueError as error:
            if not self._adopts:
                self.trouble = f"what is wanted cannot be sent: {error}"[:300]
            return None

    def _request_of(self, job: Job, now_s: float) -> Request | None:
        command = job.command
        payload = b""
        try:
            if command.op == "set":
                job.wanted = merged(self._desired, command)
                payload = checked_program(job.wanted, self.hello).to_bytes()
            elif command.op == "send":
                payload = message_of(command, self._desired.protocol, self.hello)
        except ValueError as error:
            self._finish(job, now_s, "declined", str(error))
            return None
        if command.op == "arm":
            payload = lease_of(command.lease_s or 0.0)
        return Request(KIND_OF[command.op], payload, job.deadline_s)

    def tried(self, tries: int) -> None:
        """Take note of how often the request under way has been sent."""
        if self._job is not None:
            self._job.tries = tries

    def unanswered(self, request: Request, now_s: float) -> None:
        """Take note that a request's deadline is over: what the beacon made of it has to be asked."""
        self.counters["unanswered"] += 1
        self._needs = [Kind.GET, Kind.STATUS]
        job, self._job = self._job, None
        if job is not None:
            self._finish(job, now_s, "no answer", f"{request.kind.name} was sent {job.tries} times")

    def answered(self, request: Request, result: int, rest: bytes, now_s: float) -> bool:
        """Take a reply; return False where it breaks the protocol's table."""
        if result not in Result.__members__.values() or result == Result.WRONG_BOOT:
            return False
        self._poll_s = now_s + self._config.poll_s
        if request.kind in {Kind.GET, Kind.STATUS}:
            if not self._told(request.kind, result, rest, now_s):
                return False
            if self._needs and self._needs[0] == request.kind:
                self._needs.pop(0)
            return True
        if result == Result.OK and len(rest) != {Kind.SET: 2, Kind.QUEUE: 3}.get(request.kind, 0):
            return False
        job, self._job = self._job, None
        if result == Result.OK:
            self._applied(request, rest, job, now_s)
            if job is not None:
                self._finish(job, now_s)
            return True
        self._refused(request, result, rest, job, now_s)
        return True

    def _applied(self, request: Request, rest: bytes, job: Job | None, now_s: float) -> None:
        if request.kind == Kind.SET:
            self._reported = program_of(request.payload)
            if job is not None and job.wanted is not None:
                self._desired, self._adopts = job.wanted, False
        elif request.kind == Kind.ARM:
            lease_s = int.from_bytes(request.payload, "big") / 1000
            self._reported_lit_s = now_s + lease_s
            self._adopts_lease = False
            if job is not None:
                self._lit_until_s = now_s + (job.command.lease_s or 0.0)
        elif request.kind == Kind.DISARM:
            self._reported_lit_s = 0.0
        elif request.kind == Kind.QUEUE:
            self._accepted = int.from_bytes(rest[:2], "big")

    def _refused(self, request: Request, result: int, rest: bytes, job: Job | None, now_s: float) -> None:
        where = f" (byte {rest[0]})" if result == Result.RANGE and rest else ""
        words = WORDS.get(result, "it refused") + where
        self.counters["declined"] += 1
        if job is not None:
            self._finish(job, now_s, "declined", words)
            return
        self.trouble = f"{request.kind.name} was declined: {words}"
        if request.kind == Kind.SET:
            self._declined = program_of(request.payload)
        else:  # it is not as it was believed to be
            self._needs = [Kind.GET, Kind.STATUS]

    def _told(self, kind: Kind, result: int, rest: bytes, now_s: float) -> bool:
        if kind == Kind.GET:
            if result == Result.NO_PROGRAM:
                self._reported, self._has_spoken = None, True
                return True
            program = program_of(rest[2:]) if result == Result.OK else None
            if program is None:
                return False
            self._reported, self._has_spoken = program, True
            if self._adopts:
                self._desired, self._adopts = program.to_settings(), False
            return True
        status = status_of(rest) if result == Result.OK else None
        if status is None:
            return False
        self._take_status(status, now_s)
        return True

    def _take_status(self, status: Status, now_s: float) -> None:
        self._reported_lit_s = now_s + status.lease_ms / 1000 if status.armed else 0.0
        if self._adopts_lease:  # it outlived a controller, and goes on as it was told
            self._lit_until_s, self._adopts_lease = self._reported_lit_s, False
        self._accepted, self._ended = status.accepted, status.ended
        for name in ("sent", "dropped", "damaged", "repeated", "late"):
            self.counters[f"beacon {name}"] = getattr(status, name)

    def event(self, kind: int, payload: bytes) -> bool:
        """Take an event of the present boot; return False where it is none of the protocol's."""
        if kind == Kind.DARK and not payload:
            self._reported_lit_s = 0.0
        elif kind == Kind.MESSAGE and len(payload) == 3:
            self._ended = int.from_bytes(payload[:2], "big")
        else:
            return (kind, len(payload)) in {(Kind.ON_AIR, 2), (Kind.BOOT, 9)}
        return True

    def _finish(self, job: Job, now_s: float, reason: str = "", detail: str = "") -> None:
        reply = job.reply(now_s, reason, detail)
        self.counters[reply.outcome] += 1
        if reason:
            self.trouble = f"{job.command.op}: {reason}: {detail}"[:300]
        self.replies.append((job.ticket, reply))

    # What is published

    def state(self, link: LinkWord, now_s: float) -> BeaconState:
        """Return what is known of it."""
        reported = None
        if self._has_spoken:
            reported = self._reported.to_settings() if self._reported is not None else Settings()
            reported = _with_lease(reported, self._reported_lit_s, now_s)
        return BeaconState(
            name=self.beacon.name,
            uid=self.uid,
            port=self.port,
            link=link,
            desired=_with_lease(self._desired, self._lit_until_s, now_s),
            reported=reported,
            waiting=(self._accepted - self._ended) & 0xFFFF,
            boots=self.counters["boots"],
            counters=dict(self.counters),
            trouble=self.trouble,
        )


def _wish_of(beacon: Beacon) -> Settings:
    return Settings(protocol=beacon.protocol, options=beacon.options, payload=beacon.payload, bit_rate=beacon.bit_rate)


def _with_lease(settings: Settings, until_s: float, now_s: float) -> Settings:
    left_s = max(0.0, until_s - now_s)
    return msgspec.structs.replace(settings, armed=left_s > 0.0, lease_s=round(left_s, 3))
