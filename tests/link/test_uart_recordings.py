"""The recordings of Wang et al. 2022: a sonnet sent by an LED outdoors, over 100 m and over 30 m."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from heliograph.link.contract import Receiver
from heliograph.link.modulations.uart import Uart
from support.text_light import Watched, edits, hear, joined

# (file, nominal bit rate, true one, whole characters of the earlier pass)
RECORDINGS = [("504hz_100m.mat", 504.0, 503.83, 104), ("3125hz_30m.mat", 3125.0, 3123.75, 302)]
pytestmark = pytest.mark.data


def recording(folder: Path, name: str) -> Watched:
    scipy_io = pytest.importorskip("scipy.io", reason="reading MATLAB files needs scipy")
    content = scipy_io.loadmat(folder / name)
    t_us = np.round(content["event_t"].ravel() * 1e6).astype(np.int64)
    order = np.argsort(t_us, kind="stable")
    return Watched(t_us[order], content["event"].ravel()[order] > 0, int(t_us.max()) + 1)


def read(seen: Watched, bit_rate: float) -> tuple[Receiver, str]:
    receiver = Uart().receiver(bit_rate)
    return receiver, joined(hear(receiver, seen, cuts=range(int(seen.t_us[0]), seen.until_us, 10_000)))


@pytest.mark.parametrize(("name", "bit_rate", "true_rate", "earlier"), RECORDINGS, ids=["100 m", "30 m"])
def test_the_sonnet_is_read_without_an_error_from_the_first_whole_character_on(
    beacon_data: Path, name: str, bit_rate: float, true_rate: float, earlier: int
) -> None:
    sonnet = (beacon_data / "sonnet.txt").read_text()
    seen = recording(beacon_data, name)
    receiver, text = read(seen, bit_rate)
    assert edits(sonnet[-earlier:] + sonnet, text) == 0
    assert receiver.quality(int(seen.t_us[0]) + 3_000_000).bit_rate == pytest.approx(true_rate, rel=4e-4)


def test_the_far_recording_without_two_thirds_of_its_events_is_still_read(beacon_data: Path) -> None:
    sonnet = (beacon_data / "sonnet.txt").read_text()
    seen = recording(beacon_data, "504hz_100m.mat")
    kept = np.random.default_rng(1).random(len(seen.t_us)) < 0.33
    _, text = read(Watched(seen.t_us[kept], seen.on[kept], seen.until_us), 504.0)
    assert sonnet in text
