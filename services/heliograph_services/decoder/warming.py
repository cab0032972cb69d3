"""What takes seconds at a first start: compiling the decoder's and its receivers' kernels."""

from __future__ import annotations

import numpy as np

from heliograph.core import Context
from heliograph.events import EventBatch
from heliograph.link import bitrate, cyclic_warm, ook_receiver, packet_receiver, rises, text_receiver, trial, wang2022
from heliograph.messages import Tracks
from heliograph.streams import Events
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from heliograph_services.decoder.tiles import FEW_EVENTS, WHOLE_LOOKS, Tiles


def warm_all() -> None:
    """Compile, or load from the cache, every kernel: the decoder's own, and those of cyclic codes, text and packets.

    A scene of two blinking pixels runs through a core, backlog and re-centring included. It is no text, and what a
    receiver of text compiles behind its lock would else stall the first beacon of a site.
    """
    cyclic_warm.warm()
    text_receiver.warm()
    packet_receiver.warm()
    trial.warm()
    wang2022.warm()
    bitrate.warm()
    rises.warm()
    ook_receiver.warm()
    _tiles()
    core = DecoderCore(DecoderConfig(protocol="auto"), Context(instance="warm", boot="0", lockstep=False))
    for k in range(40):
        t0_us = k * 5_000
        if k == 30:
            core.feed(_tracks(t0_us))
        t_us = np.repeat(np.arange(t0_us, t0_us + 5_000, 1_000, dtype=np.int64), 8)
        on = np.repeat(np.arange(5) % 2 == 0, 8)
        places = np.resize(np.array([3, 4, 11, 12], np.uint16), len(t_us))
        batch = EventBatch(t_us, places, places, on)
        core.feed(
            Events(
                camera="cam0", stream="warm", width=16, height=16, t0_us=t0_us, t1_us=t0_us + 5_000, batch=batch,
                end=k == 39,
            )
        )  # fmt: skip


def _tiles() -> None:
    n = FEW_EVENTS + 1
    dense = EventBatch(np.zeros(n, np.int64), np.zeros(n, np.uint16), np.zeros(n, np.uint16), np.zeros(n, np.bool_))
    tiles = Tiles([dense], 16, 16)
    for _ in range(WHOLE_LOOKS + 1):
        tiles.near(*np.zeros((3, 1)))


def _tracks(as_of_us: int) -> Tracks:
    return Tracks(
        camera="cam0", as_of_us=as_of_us, period_us=100_000, track=["a", "b"], born_us=[0, 0], seen_us=[0, 0],
        x_px=[3.5, 11.5], y_px=[3.5, 11.5], vx_px_s=[0.0, 0.0], vy_px_s=[0.0, 0.0],
        x_var_px2=[1.0, 1.0], x_vx_cov_px2_s=[0.0, 0.0], vx_var_px2_s2=[1.0, 1.0],
        y_var_px2=[1.0, 1.0], y_vy_cov_px2_s=[0.0, 0.0], vy_var_px2_s2=[1.0, 1.0],
        radius_px=[1.0, 1.0], size_px=[2.0, 2.0], polarity=[0.0, 0.0], status=["new", "new"],
    )  # fmt: skip
