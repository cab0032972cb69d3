"""Lights: where their images are (the world) and what their LEDs do (the drives), joined chunk by chunk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from heliograph_services.event_source.simulation.contract import CHUNK_US, Drive, Floats, LightChunk


class _Light(Protocol):
    @property
    def emitter(self) -> int: ...


class _World(Protocol):
    @property
    def lights(self) -> Sequence[_Light]: ...


class Lights:
    """Makes the chunks of all lights of a world; the LEDs of one beacon share its drive.

    Args:
        drives: one an emitter.
        world: its `lights`, in their order in a chunk, each with the number of its emitter.
    """

    def __init__(self, drives: Sequence[Drive], world: _World) -> None:
        self._drives = list(drives)
        self._emitter = [light.emitter for light in world.lights]

    def chunk(self, t0_us: int, geometry: tuple[Floats, Floats, Floats, Floats]) -> LightChunk:
        """Return the lights in [t0_us, t0_us + CHUNK_US).

        Args:
            t0_us: a multiple of CHUNK_US.
            geometry: x_px, y_px, sigma_px and flux_w_m2, (lights, NODES + 1) each (`World.chunk_geometry`).
        """
        level0 = [drive.level(t0_us) for drive in self._drives]
        changes = [drive.changes(t0_us, t0_us + CHUNK_US) for drive in self._drives]
        edges = [changes[i] for i in self._emitter]
        x_px, y_px, sigma_px, flux_w_m2 = geometry
        first = np.zeros(len(edges) + 1, np.int64)
        np.cumsum([len(t_us) for t_us, _ in edges], out=first[1:])
        return LightChunk(
            t0_us=t0_us,
            x_px=x_px,
            y_px=y_px,
            sigma_px=sigma_px,
            flux_w_m2=flux_w_m2,
            level0=np.array([level0[i] for i in self._emitter], np.float64),
            edge_first=first,
            edge_us=np.concatenate([t_us for t_us, _ in edges]) if edges else np.empty(0),
            edge_level=np.concatenate([level for _, level in edges]) if edges else np.empty(0),
        )
