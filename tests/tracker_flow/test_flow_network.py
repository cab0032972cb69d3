"""The parameters of the network, and their file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from heliograph.errors import ConfigError, FileError
from heliograph_services.tracker.flow.network import (
    CROSSINGS,
    DenseNetwork,
    FlowNetwork,
    load,
    offsets,
    paper_network,
    quantised,
    save,
)


def test_a_dot_that_moves_as_a_neuron_expects_reaches_it_from_five_synapses_at_once() -> None:
    network = paper_network()
    for speed, crossing in enumerate(CROSSINGS):
        dense = DenseNetwork(network, 16, 5)
        best = 0.0
        for t in range(2 * crossing):
            x = np.zeros((5, 16), np.bool_)
            # Not on the border of two pixels at a tick: which of them it is in would be a matter of rounding. The
            # fastest dot crosses two a tick.
            to, step = int(4 + (t - 0.25) * 4 / crossing), max(1, 4 // crossing)
            x[2, max(0, to - step + 1) : to + 1] = True
            dense.step(x)
            best = max(best, float(dense.s[speed].max()))
        assert best >= 5, f"{crossing} ticks: {best}"


def test_directions_are_quarter_turns_of_each_other() -> None:
    delay = paper_network().delay.reshape(8, 4, 5, 5)
    for direction in range(8):
        turned = np.rot90(delay[direction], k=-1, axes=(1, 2))
        assert (delay[(direction + 2) % 8] == turned).all()


def test_delays_grow_against_the_direction_and_stay_within_the_crossing() -> None:
    network = paper_network()
    for k in range(32):
        p = offsets() @ network.velocity[k]
        order = np.argsort(p)
        assert (np.diff(network.delay[k][order]) <= 0).all()
        assert network.delay[k].max() == CROSSINGS[k % 4]
        assert network.delay[k].min() == 0


def test_a_saved_network_is_loaded_unchanged(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    network = replace(
        paper_network(0.9, 4.5), weight=quantised(rng.normal(1, 0.5, (32, 25))), g="identity", h="step_above"
    )
    save(network, tmp_path / "n.npz")
    again = load(tmp_path / "n.npz")
    for name in FlowNetwork.__slots__:
        assert np.array_equal(getattr(network, name), getattr(again, name)), name


@pytest.mark.parametrize(
    ("field", "value"),
    [("version", np.array(2)), ("schema", np.array("other")), ("delay", None), ("delay", np.zeros((32, 25)) + 0.5)],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, field: str, value: np.ndarray | None) -> None:
    save(paper_network(), tmp_path / "n.npz")
    fields = dict(np.load(tmp_path / "n.npz"))
    if value is None:
        del fields[field]
    else:
        fields[field] = value
    np.savez(tmp_path / "m.npz", **fields)
    with pytest.raises(FileError, match=r"m\.npz"):
        load(tmp_path / "m.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no archive"])
def test_a_damaged_file_is_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "n.npz").write_bytes(content)
    with pytest.raises(FileError, match="not an NPZ file"):
        load(tmp_path / "n.npz")
    with pytest.raises(FileError, match="No such file"):
        load(tmp_path / "absent.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"delay": np.full((32, 25), 11)},
        {"weight": np.full((32, 25), 0.1, np.float32)},
        {"weight": np.full((32, 25), np.nan, np.float32)},
        {"velocity": np.zeros((32, 2))},
        {"v_th": 0.0},
        {"l_tau": 1.0},
        {"g": "tanh"},
        {"delay": np.zeros((8, 25), np.int64)},
    ],
)
def test_a_parameter_out_of_range_is_an_operators_error(change: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        replace(paper_network(), **change)  # type: ignore[arg-type]  # wrong on purpose
