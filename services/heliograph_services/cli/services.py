"""The kinds of process that a site file may name: where their settings are defined."""

from __future__ import annotations

from importlib import import_module
from typing import Final

import msgspec

from heliograph.errors import ConfigError

KINDS: Final[dict[str, tuple[str, str]]] = {
    "event_source": ("heliograph_services.event_source.config", "EventSourceConfig"),
    "tracker": ("heliograph_services.tracker.config", "TrackerConfig"),
    "decoder": ("heliograph_services.decoder.config", "DecoderConfig"),
    "beacon_controller": ("heliograph_services.beacon_controller.config", "BeaconControllerConfig"),
    "metrics_sink": ("heliograph_services.metrics_sink.config", "MetricsSinkConfig"),
}


def config_type(kind: str) -> type[msgspec.Struct]:
    """Return the settings' type of a kind of process.

    Raises:
        ConfigError: there is no such kind.
    """
    if kind not in KINDS:
        raise ConfigError(f"kind must be one of {', '.join(KINDS)}, not {kind!r}")
    module, name = KINDS[kind]
    kind_of_config: type[msgspec.Struct] = getattr(import_module(module), name)
    return kind_of_config
