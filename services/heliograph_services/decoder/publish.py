"""What the decoder knows, as records for the bus; numbers rounded to what they mean, so that they stay short."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Final

import msgspec

from heliograph.errors import Refusals, by_name
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text
from heliograph.messages import Bearing, Change, Data, Frames, Identification, Link, Message, Status, StatusWord
from heliograph_services.decoder.regions import Place

BearingOf = Callable[[float, float], Bearing]
# A micropixel of a bearing at a focal length of 1000 px is 1e-9; the wire carries 1e-6, 0.2 arc seconds.
BEARING_DIGITS: Final = 6
# Log-likelihoods may be infinite where a runner-up is impossible; records carry finite numbers.
MARGIN_LIMIT: Final = 1e9


def bearing_of(camera_text: str) -> BearingOf | None:
    """Return what gives a pixel its bearing, or None without a camera file."""
    if not camera_text:
        return None
    from heliograph.camera import parse  # noqa: PLC0415 - only a site with a camera file needs it

    return parse(camera_text).bearing


def px(value: float) -> float:
    """Return pixels (or px/s) to a thousandth, never -0."""
    return round(float(value), 3) + 0.0


def share(value: float) -> float:
    """Return a share of 1, to a ten-thousandth, clipped into [0, 1]; what is no number is 0."""
    return round(min(max(float(value), 0.0), 1.0), 4) if math.isfinite(value) else 0.0


def nats(value: float) -> float:
    """Return a log-likelihood to a ten-thousandth, finite."""
    if math.isnan(value):
        return 0.0
    return round(min(max(float(value), -MARGIN_LIMIT), MARGIN_LIMIT), 4)


class FrameRow(msgspec.Struct, frozen=True):
    """A frame of a track, ready to be published."""

    serial: int
    track: str
    protocol: str
    beacon: str | None
    frame: LinkFrame
    at: Place


class Publisher:
    """Makes the records of one camera.

    Args:
        camera: its name.
        bearing: gives the unit vector of a pixel in the camera's frame; None without a camera file.
    """

    def __init__(self, camera: str, bearing: BearingOf | None) -> None:
        self._camera = camera
        self._bearing = bearing

    def frames(self, rows: list[FrameRow], refused: Refusals, t0_us: int, t1_us: int) -> Frames:
        """Return the frames of a window by (t_us, track), and what was refused in it."""
        if len(rows) > 1:
            rows = sorted(rows, key=lambda row: (row.frame.t_us, row.serial))
        return Frames(
            camera=self._camera,
            t0_us=t0_us,
            t1_us=t1_us,
            t_us=[row.frame.t_us for row in rows],
            track=[row.track for row in rows],
            protocol=[row.protocol for row in rows],
            beacon=[row.beacon for row in rows],
            payload=[row.frame.payload for row in rows],
            x_px=[px(row.at.x_px) for row in rows],
            y_px=[px(row.at.y_px) for row in rows],
            score=[share(row.frame.score) for row in rows],
            refused=by_name(refused),
        )

    def identification(
        self,
        track: str,
        protocol: str,
        beacon: str,
        identity: Identity,
        at: Place,
        t_us: int,
        change: Change,
        duplicates: list[str],
    ) -> Identification:
        """Return the state of a track that is, or was until now, identified."""
        return Identification(
            camera=self._camera,
            track=track,
            t_us=t_us,
            since_us=identity.since_us,
            protocol=protocol,
            beacon=beacon,
            payload=identity.payload,
            x_px=px(at.x_px),
            y_px=px(at.y_px),
            vx_px_s=px(at.vx_px_s),
            vy_px_s=px(at.vy_px_s),
            bearing=self._bearing_of(at),
            confidence=share(identity.confidence),
            margin=nats(identity.margin),
            frames_used=identity.frames_used,
            change=change,
            lost=change == "lost",
            duplicates=duplicates,
        )

    def again(
        self, state: Identification, track: str, t_us: int, change: Change, at: Place | None = None
    ) -> Identification:
        """Return a published state under another name or change, and elsewhere, if that is given."""
        again = msgspec.structs.replace(state, track=track, t_us=t_us, change=change, lost=change == "lost")
        if at is None:
            return again
        return msgspec.structs.replace(
            again,
            x_px=px(at.x_px),
            y_px=px(at.y_px),
            vx_px_s=px(at.vx_px_s),
            vy_px_s=px(at.vy_px_s),
            bearing=self._bearing_of(at),
        )

    def _bearing_of(self, at: Place) -> Bearing | None:
        if self._bearing is None:
            return None
        x, y, z = (round(float(value), BEARING_DIGITS) + 0.0 for value in self._bearing(at.x_px, at.y_px))
        return (x, y, z)

    def data(self, track: str, protocol: str, beacon: str | None, texts: Iterable[Text]) -> list[Message]:
        """Return the texts of a track joined: a record for a run of characters, of bytes, and for a whole message."""
        out: list[Message] = []
        run: list[Text] = []
        for text in texts:
            if run and (text.whole or run[-1].whole or (text.text is None) != (run[-1].text is None)):
                out.append(self._data(track, protocol, beacon, run))
                run = []
            run.append(text)
        if run:
            out.append(self._data(track, protocol, beacon, run))
        return out

    def _data(self, track: str, protocol: str, beacon: str | None, run: list[Text]) -> Data:
        is_text = run[0].text is not None
        return Data(
            camera=self._camera,
            track=track,
            t_us=run[-1].t_us,
            protocol=protocol,
            beacon=beacon,
            text="".join(one.text or "" for one in run) if is_text else None,
            data=None if is_text else b"".join(one.data or b"" for one in run),
        )

    def link(self, track: str, protocol: str, t_us: int, quality: LinkQuality) -> Link:
        """Return how well a track was read over the last second."""
        return Link(
            camera=self._camera,
            track=track,
            t_us=t_us,
            protocol=protocol,
            bit_rate=_known(quality.bit_rate) or 0.0,
            snr_db=_known(quality.snr_db),
            jitter_us=_known(quality.jitter_us),
            clock_ppm=_known(quality.clock_ppm),
            events_per_transition=_known(quality.events_per_transition),
            mar_estimate=None if quality.mar_estimate is None else share(quality.mar_estimate),
        )

    def status(
        self,
        tracks: list[str],
        words: list[StatusWord],
        frames_us: list[int],
        identities: list[str | None],
        as_of_us: int,
    ) -> Status:
        """Return the statuses of all tracks: name, word, end of the last frame or -1, token of its identity."""
        return Status(
            camera=self._camera,
            as_of_us=as_of_us,
            track=tracks,
            status=words,
            accepted_us=frames_us,
            identity=identities,
        )


def _known(value: float | None) -> float | None:
    return px(value) if value is not None and math.isfinite(value) else None
