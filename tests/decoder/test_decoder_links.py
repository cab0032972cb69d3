"""What is heard of a track: contests of links, bit rates, texts, tokens, receivers that give up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from heliograph.errors import ConfigError, Refusal
from heliograph.events import Flags, Times
from heliograph.messages import Data, Frames, Identification, Link, Status
from heliograph.site import Beacon
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import TrackLinks
from heliograph_services.decoder.routing import HEART_OF
from support.blinkers import FRAME_US, Disc, PulseReceiver, messages, pulse_only, scene, still, tracks
from support.decoding import CRANE, HEIGHT, LIVE, WIDTH, core, run, states


def test_an_unlisted_payload_is_called_by_protocol_and_payload() -> None:
    disc = Disc(7, still(100, 100))
    out = run(core(), scene([disc], 0, 300_000, WIDTH, HEIGHT), [(20_000, tracks(0, [("a-0", disc, 0)]))], 300_000)
    assert states(out)[0].beacon == "pulse:7"
    assert {name for one in out if isinstance(one, Frames) for name in one.beacon} == {None}


def test_texts_are_joined_over_the_refreshing_time_and_none_is_lost() -> None:
    disc = Disc(5, still(100, 100))
    says = Beacon(name="crane", protocol="pulse", payload=5, bit_rate=100, options={"says": 1})
    batch = scene([disc], 0, 555_000, WIDTH, HEIGHT)
    decoder = core(says)
    decoder.feed(tracks(0, [("a-0", disc, 0)]))
    out = [one for m in messages(batch, 0, 555_000, range(0, 555_000, 2_000), WIDTH, HEIGHT) for one in decoder.feed(m)]
    data = [one for one in out if isinstance(one, Data)]
    frames = sum(len(one.t_us) for one in out if isinstance(one, Frames))
    assert "".join(one.text or "" for one in data) == "f" * (frames - 2)
    assert [len(one.text or "") for one in data] == [8, 10, 10, 10, 10, 6]
    assert {one.beacon for one in data} == {"crane"}
    assert isinstance(out[-1], Identification)
    assert out[-1].lost


def test_link_quality_is_sent_every_second_for_what_is_read() -> None:
    read, dark = Disc(5, still(100, 100)), Disc(5, still(300, 300), lit_us=(0, 0))
    batch = scene([read, dark], 0, 2_500_000, WIDTH, HEIGHT)
    rows = [("a-0", read, 0), ("a-1", dark, 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, 2_500_000, 100_000)]
    out = run(core(), batch, told, 2_500_000)
    assert [(one.t_us, one.track) for one in out if isinstance(one, Link)] == [(1_000_000, "a-0"), (2_000_000, "a-0")]


def test_a_contest_of_links_has_one_winner_and_every_frame_once() -> None:
    # Two links that read the same signal equally well: the first listed wins, and what was held of it is released.
    disc = Disc(5, still(100, 100))
    other = Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)
    out = run(
        core(CRANE, other), scene([disc], 0, 400_000, WIDTH, HEIGHT), [(20_000, tracks(0, [("a-0", disc, 0)]))], 400_000
    )
    assert {one.beacon for one in states(out)} == {"crane"}
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) == len(set(ends)) == 40


def test_a_contest_that_nobody_wins_publishes_its_frames_a_second_late() -> None:
    # Payloads that alternate are never an identity.
    discs = [
        Disc(payload, still(100, 100), lit_us=(t, t + FRAME_US))
        for k, t in enumerate(range(0, 1_600_000, FRAME_US))
        for payload in (5 if k % 2 else 2,)
    ]
    batch = scene(discs, 0, 1_600_000, WIDTH, HEIGHT)
    told = [(t + 20_000, tracks(t, [("a-0", discs[0], 0)])) for t in range(0, 1_600_000, 100_000)]
    other = Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)
    for beacons, delay_us in (((CRANE,), 0), ((CRANE, other), 1_000_000)):
        out = run(core(*beacons), batch, told, 1_600_000)
        assert not states(out)
        late = [one.t1_us - t for one in out if isinstance(one, Frames) for t in one.t_us if t > 100_000]
        assert late
        assert min(late) >= delay_us
        assert max(late) <= delay_us + 5_000


class Flaky(PulseReceiver):
    """Gives up for good after half a second of silence."""

    def verdict(self, now_us: int) -> str:  # type: ignore[override]
        return "invalid" if now_us - max(self._last_us, 1) > 500_000 else super().verdict(now_us)

    def _decide(self, t_us: int, payload: int) -> list:  # type: ignore[type-arg]
        return [] if self._last_us and t_us - self._last_us > 500_000 else super()._decide(t_us, payload)


def test_a_receiver_that_has_given_up_is_made_anew_where_the_track_goes_on() -> None:
    def flaky(name: str, **options: str | int):  # type: ignore[no-untyped-def]
        made = pulse_only(name, **options)
        made.receiver = lambda bit_rate, name="default": Flaky(says=False)  # type: ignore[method-assign]
        return made

    first = Disc(5, still(100, 100), lit_us=(0, 300_000))
    second = Disc(5, still(100, 100), lit_us=(3_500_000, 9_000_000))
    batch = scene([first, second], 0, 4_000_000, WIDTH, HEIGHT)
    decoder = DecoderCore(DecoderConfig(beacons=(CRANE,)), LIVE, modulation_of=flaky)
    told = [(t + 20_000, tracks(t, [("a-0", first, 0)])) for t in range(0, 4_000_000, 100_000)]
    out = run(decoder, batch, told, 4_000_000)
    assert [one.change for one in states(out, "accepted", "lost")] == ["accepted", "lost", "accepted"]
    words = {one.as_of_us: one.status for one in out if isinstance(one, Status)}
    assert words[1_000_000] == ["invalid"]


def test_an_unknown_bit_rate_is_measured_and_nothing_heard_meanwhile_is_lost() -> None:
    disc = Disc(5, still(100, 100), lit_us=(3_000_000, 9_000_000))
    batch = scene([disc, Disc(5, still(100, 100), lit_us=(0, 10_000))], 0, 4_000_000, WIDTH, HEIGHT)
    asked: list[int] = []

    def measure(t_us: Times, on: Flags) -> tuple[float, ...]:
        asked.append(len(t_us))
        return (100.0,) if len(t_us) > 200 else ()

    config = DecoderConfig(protocol="pulse", bit_rate="auto")
    decoder = DecoderCore(config, LIVE, modulation_of=pulse_only, measure=measure)
    told = [(t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(0, 4_000_000, 100_000)]
    out = run(decoder, batch, told, 4_000_000)
    assert decoder.refusals[Refusal.NO_CLOCK] == 1
    assert len(asked) < 10
    ends = [t for one in out if isinstance(one, Frames) for t in one.t_us]
    assert len(ends) == 100
    assert states(out, "accepted")[0].beacon == "pulse:5"


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"protocol": "morse"}, "protocol must be pulse, not 'morse'"),
        ({"protocol": "pulse", "receiver": "paper"}, "receiver of pulse must be default, not 'paper'"),
        (
            {"beacons": (Beacon(name="far", protocol="pulse", payload=99, bit_rate=100),)},
            r"beacon far: payload must be in \[0, 15\], not 99",
        ),
    ],
)
def test_an_operators_mistake_is_one_line(settings: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        DecoderCore(DecoderConfig(**settings), LIVE, modulation_of=pulse_only)  # type: ignore[arg-type]


def test_a_status_says_by_a_token_who_a_track_is_held_for() -> None:
    # Two links of one protocol: payload 5 at 100 and at 200 bit/s are two beacons.
    read, dark = Disc(5, still(100, 100)), Disc(5, still(300, 300), lit_us=(0, 0))
    batch = scene([read, dark], 0, 400_000, WIDTH, HEIGHT)
    rows = [("a-0", read, 0), ("a-1", dark, 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, 400_000, 100_000)]
    twin = Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)
    for beacons, token in (((CRANE,), "pulse/5"), ((CRANE, twin), "pulse.0/5")):
        out = run(core(*beacons), batch, told, 400_000)
        statuses = {
            one.as_of_us: dict(zip(one.track, one.identity, strict=True)) for one in out if isinstance(one, Status)
        }
        assert statuses[400_000] == {"a-0": token, "a-1": None}
        assert set(statuses[100_000].values()) <= {None, token}


def test_text_has_no_token() -> None:
    plan = LinkPlan(DecoderConfig(protocol="uart"))
    assert plan.token(0, None) is None


def test_a_frame_that_is_published_a_second_late_says_where_its_beacon_was() -> None:
    # Two links that nobody wins hold frames; meanwhile the beacon has turned.
    def curve(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return 320 + 100 * np.cos(3 * s), 240 + 100 * np.sin(3 * s)

    discs = [
        Disc(payload, curve, lit_us=(t, t + FRAME_US))
        for k, t in enumerate(range(0, 2_000_000, FRAME_US))
        for payload in (5 if k % 2 else 2,)
    ]
    batch = scene(discs, 0, 2_000_000, WIDTH, HEIGHT)
    told = [(t + 20_000, tracks(t, [("a-0", discs[0], 0)])) for t in range(0, 2_000_000, 100_000)]
    out = run(core(CRANE, Beacon(name="twin", protocol="pulse", payload=5, bit_rate=200)), batch, told, 2_000_000)
    rows = [row for one in out if isinstance(one, Frames) for row in zip(one.t_us, one.x_px, one.y_px, strict=True)]
    assert len(rows) > 150
    for t_us, x_px, y_px in rows:
        x, y = curve(np.array([t_us / 1e6]))
        assert np.hypot(x - x_px, y - y_px) < 2.0


@pytest.mark.parametrize("measured", [False, True])
def test_fast_links_hear_the_core_slow_ones_the_heart_those_between_the_whole(
    measured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: dict[float, PulseReceiver] = {}

    def noted(name: str, **options: str | int):  # type: ignore[no-untyped-def]
        kind = pulse_only(name, **options)
        monkeypatch.setattr(
            kind, "receiver", lambda rate, _="default": made.setdefault(rate, PulseReceiver(says=False))
        )
        return kind

    listed = [Beacon(name=f"b{rate}", protocol="pulse", payload=1, bit_rate=rate) for rate in (50, 1_000, 4_000)]
    given = {"protocol": "pulse", "bit_rate": "auto"} if measured else {"beacons": tuple(listed)}
    config = DecoderConfig(core_bit_rate=4_000.0, heart_bit_rate=50.0, **given)
    plan = LinkPlan(config, noted, lambda t_us, on: (4_000.0,))
    made.clear()
    links = TrackLinks(plan)
    depth = np.array([0, 1, 2, 0, 1], np.uint8)
    for k in range(2):
        t_us = np.arange(5, dtype=np.int64) * 60_000 + k * 300_000
        links.feed(t_us, np.ones(5, np.bool_), depth, (k + 1) * 300_000)
    heard = {rate: one.heard for rate, one in made.items()}
    assert heard == ({4_000.0: 6} if measured else {50.0: 2, 1_000.0: 10, 4_000.0: 6})


def test_the_papers_receiver_hears_the_whole_at_every_rate() -> None:
    listed = [Beacon(name=f"b{rate}", protocol="seed11", payload=42, bit_rate=rate) for rate in (50, 2_500, 4_000)]
    ours, papers = (LinkPlan(DecoderConfig(beacons=tuple(listed), receiver=name)) for name in ("default", "paper"))
    assert [ours.depth(i, row.key.bit_rate or 0.0) > 0 for i, row in enumerate(ours.rows)] == [True, False, True]
    assert [papers.depth(i, row.key.bit_rate or 0.0) for i, row in enumerate(papers.rows)] == [0, 0, 0]


def test_slow_words_hear_the_heart_and_slow_pulses_the_whole() -> None:
    listed = [
        Beacon(name="word", protocol="seed11", payload=42, bit_rate=1_000),
        Beacon(name="pulse", protocol="pulse_interval", payload=42, bit_rate=1_000),
        Beacon(name="slow-pulse", protocol="pulse_interval", payload=42, bit_rate=100),
    ]
    plan = LinkPlan(DecoderConfig(beacons=tuple(listed)))
    assert [plan.depth(i, row.key.bit_rate or 0.0) for i, row in enumerate(plan.rows)] == [HEART_OF, 0, HEART_OF]


def test_slow_text_hears_the_heart_and_fast_text_the_whole() -> None:
    listed = [Beacon(name=f"b{rate}", protocol="uart", bit_rate=rate) for rate in (504, 3_125, 10_000)]
    plan = LinkPlan(DecoderConfig(beacons=tuple(listed)))
    assert [plan.depth(i, row.key.bit_rate or 0.0) for i, row in enumerate(plan.rows)] == [HEART_OF, 0, 0]
