"""Small worlds worked by hand: what a beacon sends, and what a decoder might say of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np

from heliograph.messages import Change, Data, Frames, Identification, Link, Tracks
from heliograph.truth import Truth

CAMERA = "cam0"
WINDOW_US = 10_000
FRAME_US = 11_000  # 11 bits at 1 kbit/s


@dataclass(frozen=True)
class Sent:
    """One beacon of the truth: where it is, from when to when it is visible, and what it sends."""

    name: str = "crane"
    protocol: str = "seed11"
    x_px: float = 100.0
    y_px: float = 100.0
    vx_px_s: float = 0.0
    radius_px: float = 3.0
    payload: int = 42
    frame_us: int = FRAME_US
    hidden: tuple[tuple[int, int], ...] = ()  # occluded, but in view
    outside: tuple[tuple[int, int], ...] = ()

    def x_at(self, t_us: int) -> float:
        return self.x_px + self.vx_px_s * t_us / 1e6

    def ends(self, until_us: int) -> list[int]:
        return list(range(self.frame_us, until_us + 1, self.frame_us))


def _in(spans: tuple[tuple[int, int], ...], t0_us: int, t1_us: int) -> bool:
    return any(t0_us < b and t1_us > a for a, b in spans)


def truth(beacons: list[Sent], until_us: int, window_us: int = WINDOW_US, camera: str = CAMERA) -> list[Truth]:
    """The truth of [0, until), window by window."""
    messages = []
    for t0_us in range(0, until_us, window_us):
        t1_us = t0_us + window_us
        frames = [(i, b, end) for i, b in enumerate(beacons) for end in b.ends(t1_us) if t0_us < end <= t1_us]
        messages.append(
            Truth(
                camera=camera,
                t0_us=t0_us,
                t1_us=t1_us,
                sensor="ideal",
                fidelity="full",
                beacon=[b.name for b in beacons],
                protocol=[b.protocol for b in beacons],
                x_px=[b.x_at(t1_us) for b in beacons],
                y_px=[b.y_px for b in beacons],
                radius_px=[b.radius_px for b in beacons],
                x_m=[0.0 for _ in beacons],
                y_m=[0.0 for _ in beacons],
                z_m=[0.0 for _ in beacons],
                in_view=[not _in(b.outside, t0_us, t1_us) for b in beacons],
                visible=[not _in(b.hidden + b.outside, t0_us, t1_us) for b in beacons],
                frame_beacon=[i for i, _, _ in frames],
                frame_t0_us=[end - b.frame_us for _, b, end in frames],
                frame_t1_us=[end for _, _, end in frames],
                frame_payload=[b.payload for _, b, _ in frames],
                frame_x_px=[b.x_at(end) for _, b, end in frames],
                frame_y_px=[b.y_px for _, b, _ in frames],
                frame_visible=[not _in(b.hidden + b.outside, end - b.frame_us, end) for _, b, end in frames],
                edge_beacon=np.empty(0, np.uint16),
                edge_us=np.empty(0),
                edge_on=np.empty(0, np.bool_),
            )
        )
    return messages


@dataclass
class Said:
    """Frames that a decoder publishes; `add` in any order."""

    rows: list[tuple[int, str, str, int, float, float]] = field(default_factory=list)
    refused: dict[str, int] = field(default_factory=dict)

    def add(
        self,
        t_us: int,
        payload: int = 42,
        x_px: float = 100.0,
        y_px: float = 100.0,
        track: str = "t-0",
        protocol: str = "seed11",
    ) -> Said:
        self.rows.append((t_us, track, protocol, payload, x_px, y_px))
        return self

    def all_of(self, beacon: Sent, until_us: int, track: str = "t-0", late_us: int = 0) -> Said:
        for end in beacon.ends(until_us):
            self.add(end + late_us, beacon.payload, beacon.x_at(end), beacon.y_px, track, beacon.protocol)
        return self

    def messages(self, window_us: int = 5_000, camera: str = CAMERA) -> list[Frames]:
        by_window: dict[int, list[tuple[int, str, str, int, float, float]]] = {}
        for row in sorted(self.rows):
            by_window.setdefault(-(-row[0] // window_us), []).append(row)
        return [
            Frames(
                camera=camera,
                t0_us=(number - 1) * window_us,
                t1_us=number * window_us,
                t_us=[row[0] for row in rows],
                track=[row[1] for row in rows],
                protocol=[row[2] for row in rows],
                beacon=[None] * len(rows),
                payload=[row[3] for row in rows],
                x_px=[row[4] for row in rows],
                y_px=[row[5] for row in rows],
                score=[1.0] * len(rows),
                refused=self.refused,
            )
            for number, rows in sorted(by_window.items())
        ]


def state(
    t_us: int,
    change: Change = "accepted",
    beacon: str = "crane",
    track: str = "t-0",
    since_us: int | None = None,
    payload: int | None = 42,
    protocol: str = "seed11",
    x_px: float = 100.0,
    y_px: float = 100.0,
    camera: str = CAMERA,
) -> Identification:
    return Identification(
        camera=camera,
        track=track,
        t_us=t_us,
        since_us=t_us if since_us is None else since_us,
        protocol=protocol,
        beacon=beacon,
        payload=payload,
        x_px=x_px,
        y_px=y_px,
        vx_px_s=0.0,
        vy_px_s=0.0,
        bearing=None,
        confidence=1.0,
        margin=10.0,
        frames_used=4,
        change=change,
        lost=change == "lost",
    )


def tracks(t_us: int, names: tuple[str, ...] = ("t-0",), camera: str = CAMERA) -> Tracks:
    n = len(names)
    return Tracks(
        camera=camera,
        as_of_us=t_us,
        period_us=100_000,
        track=list(names),
        born_us=[0] * n,
        seen_us=[t_us] * n,
        x_px=[100.0] * n,
        y_px=[100.0] * n,
        vx_px_s=[0.0] * n,
        vy_px_s=[0.0] * n,
        x_var_px2=[1.0] * n,
        x_vx_cov_px2_s=[0.0] * n,
        vx_var_px2_s2=[1.0] * n,
        y_var_px2=[1.0] * n,
        y_vy_cov_px2_s=[0.0] * n,
        vy_var_px2_s2=[1.0] * n,
        radius_px=[3.0] * n,
        size_px=[28.0] * n,
        polarity=[0.0] * n,
        status=["valid"] * n,
    )


def text(t_us: int, characters: str, camera: str = CAMERA) -> Data:
    return Data(camera=camera, track="t-1", t_us=t_us, protocol="uart", beacon="gate", text=characters, data=None)


def link(t_us: int, mar: float | None, camera: str = CAMERA) -> Link:
    return Link(
        camera=camera,
        track="t-0",
        t_us=t_us,
        protocol="seed11",
        bit_rate=1000.0,
        snr_db=None,
        jitter_us=None,
        clock_ppm=None,
        events_per_transition=None,
        mar_estimate=mar,
    )


def shifted(message: Truth, by_us: int) -> Truth:
    """The same window later: for streams that begin anew."""
    return msgspec.structs.replace(
        message,
        t0_us=message.t0_us + by_us,
        t1_us=message.t1_us + by_us,
        frame_t0_us=[t + by_us for t in message.frame_t0_us],
        frame_t1_us=[t + by_us for t in message.frame_t1_us],
    )
