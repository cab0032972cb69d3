"""What torch exports, and NIR."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph_services.tracker.flow.network import FlowNetwork, paper_network

torch = pytest.importorskip("torch", reason="torch is not installed (extra [reference])")
nir = pytest.importorskip("nir", reason="nir is not installed (extra [reference])")

from heliograph_services.tracker.flow import torch_net  # noqa: E402  # needs torch and nir


def same(a: FlowNetwork, b: FlowNetwork) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in FlowNetwork.__slots__)


def test_torch_exports_what_it_was_made_of() -> None:
    network = paper_network(0.5)
    assert same(torch_net.TorchNetwork(network).export(), network)


def test_trained_weights_are_exported_on_the_grid() -> None:
    model = torch_net.TorchNetwork(paper_network())
    with torch.no_grad():
        model.weight.add_(0.1)
    assert (model.export().weight == np.float32(round(1.1 * 256) / 256)).all()


@pytest.mark.parametrize("l_tau", [0.0, 0.5, 0.9])
def test_a_network_comes_back_from_nir(tmp_path: Path, l_tau: float) -> None:
    network = paper_network(l_tau)
    torch_net.save_nir(network, tmp_path / "flow.nir", 12, 8)
    assert same(torch_net.load_nir(tmp_path / "flow.nir", network.velocity), network)


@pytest.mark.parametrize("l_tau", [0.0, 0.5])
def test_the_graph_computes_the_networks_spikes(l_tau: float) -> None:
    """Its nodes run as NIR defines them: delays, convolutions, Euler's step of the LIF with one tick."""
    network = paper_network(l_tau)
    graph = torch_net.to_nir(network, 12, 8)
    reference = torch_net.TorchNetwork(network)
    lif = graph.nodes["lif"]
    v = np.zeros((32, 8, 12))
    past: list[np.ndarray] = []
    rng = np.random.default_rng(2)
    for _ in range(40):
        x = (rng.random((8, 12)) < 0.2).astype(np.float32)
        past = [x, *past[:10]]
        current = np.zeros_like(v)
        for d in range(11):
            conv = graph.nodes[f"conv{d}"]
            ticks = int(graph.nodes[f"delay{d}"].delay.flat[0])
            if ticks < len(past):
                image = torch.from_numpy(past[ticks])[None, None]
                drive = torch.nn.functional.conv2d(image, torch.from_numpy(conv.weight), padding=conv.padding)
                current += drive[0].numpy()
        v = v + (lif.v_leak - v + lif.r * current) / lif.tau
        fired = v >= lif.v_threshold
        with torch.no_grad():
            want = reference(torch.from_numpy(x)).numpy()
        assert (fired == want.astype(np.bool_)).all()
        v = np.where(fired, lif.v_reset, v)


def test_what_nir_cannot_say_is_refused() -> None:
    network = paper_network()
    negative = FlowNetwork(network.delay, -network.weight, network.velocity)
    with pytest.raises(ConfigError, match="negative"):
        torch_net.to_nir(negative, 8, 8)
    with pytest.raises(ConfigError, match="not a graph"):
        torch_net.from_nir(
            nir.NIRGraph({"input": nir.Input({"input": np.array([1])})}, [], type_check=False), network.velocity
        )
