"""The kernels' spikes are those of the equations, and of torch: every one, with its potential."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph_services.tracker.flow.kernel import make_runtime
from heliograph_services.tracker.flow.network import (
    Activation,
    DenseNetwork,
    FlowNetwork,
    Output,
    paper_network,
    quantised,
)
from heliograph_services.tracker.flow.spikes import Runtime, Spikes
from heliograph_services.tracker.flow.tables import TableRuntime
from heliograph_services.tracker.flow.words import WordRuntime

Image = npt.NDArray[np.bool_]
Named = dict[tuple[int, int, int], float]


def named(spikes: Spikes) -> Named:
    out = dict(
        zip(zip(spikes.x.tolist(), spikes.y.tolist(), spikes.k.tolist(), strict=True), spikes.s.tolist(), strict=True)
    )
    assert len(out) == len(spikes), "a spike twice"
    return out


def of_dense(y: Image, s: npt.NDArray[np.float32]) -> Named:
    k, row, column = np.nonzero(y)
    return dict(zip(zip(column.tolist(), row.tolist(), k.tolist(), strict=True), s[y].tolist(), strict=True))


def fed(runtime: Runtime, x: Image) -> Named:
    row, column = np.nonzero(x)
    return named(runtime.step(column, row))


def images(width: int, height: int, ticks: int, seed: int) -> Iterator[Image]:
    """Yield noise, edges that cross every border, and a gap longer than any delay."""
    rng = np.random.default_rng(seed)
    for t in range(ticks):
        x = rng.random((height, width)) < (0.06 if t % 40 < 20 else 0.0)
        if not 20 <= t % 40 < 34:
            x[:, t % width] = True
            x[-1 - t // 2 % height] = True
            np.fill_diagonal(x[:, max(0, t - 20) :], True)
        yield x


def runtimes(network: FlowNetwork, width: int, height: int) -> list[Runtime]:
    out: list[Runtime] = [TableRuntime(network, width, height)]
    if network.l_tau == 0 and np.isin(network.weight, (0, 1)).all():
        out.append(WordRuntime(network, width, height))
    return out


@pytest.mark.parametrize("l_tau", [0.0, 0.5, 0.9])
@pytest.mark.parametrize(("width", "height"), [(70, 19), (128, 6), (3, 2)])
def test_spikes_are_those_of_torch(l_tau: float, width: int, height: int) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed (extra [reference])")
    pytest.importorskip("nir", reason="nir is not installed (extra [reference])")
    from heliograph_services.tracker.flow.torch_net import TorchNetwork  # noqa: PLC0415

    torch.set_num_threads(1)
    network = paper_network(l_tau)
    reference = TorchNetwork(network)
    ours = runtimes(network, width, height)
    total = 0
    with torch.no_grad():
        for x in images(width, height, 80, seed=3):
            y = reference(torch.from_numpy(x.astype(np.float32))).numpy().astype(np.bool_)
            assert reference.s is not None
            want = of_dense(y, reference.s[0].numpy())
            total += len(want)
            for runtime in ours:
                assert fed(runtime, x) == want
    assert total > 1000 or width == 3


@pytest.mark.parametrize("l_tau", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("v_th", [5.0, 4.5, 11.0, 25.0, 26.0])
@pytest.mark.parametrize("h", ["step", "step_above"])
def test_spikes_are_those_of_the_equations(l_tau: float, v_th: float, h: Output) -> None:
    network = replace(paper_network(l_tau, v_th), h=h)
    reference = DenseNetwork(network, 67, 9)
    ours = runtimes(network, 67, 9)
    for x in images(67, 9, 50, seed=4):
        want = of_dense(reference.step(x), reference.s)
        for runtime in ours:
            assert fed(runtime, x) == want


@pytest.mark.parametrize("g", ["relu", "identity"])
def test_learned_weights_fire_the_same_neurons(g: Activation) -> None:
    rng = np.random.default_rng(5)
    network = replace(
        paper_network(0.9, 3.0),
        delay=rng.integers(0, 11, (32, 25)),
        weight=quantised(rng.normal(0.4, 1.0, (32, 25))),
        g=g,
    )
    reference, ours = DenseNetwork(network, 33, 8), TableRuntime(network, 33, 8)
    for x in images(33, 8, 80, seed=6):
        want = of_dense(reference.step(x), reference.s)
        assert fed(ours, x) == want


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 2**32 - 1)), min_size=1, max_size=8), st.booleans())
def test_skipping_ticks_is_feeding_empty_ones(gaps: list[tuple[int, int]], memory: bool) -> None:
    network = paper_network(0.9 if memory else 0.0)
    stepped, skipped = make_runtime(network, 20, 7), make_runtime(network, 20, 7)
    for gap, seed in gaps:
        x = np.random.default_rng(seed).random((7, 20)) < 0.4
        assert fed(stepped, x) == fed(skipped, x)
        empty = [fed(stepped, np.zeros_like(x)) for _ in range(gap)]
        passed = [named(spikes) for spikes in skipped.skip(gap)]
        assert empty[: len(passed)] == passed
        assert not any(empty[len(passed) :])


def test_a_network_without_memory_runs_by_words_and_one_with_memory_by_tables() -> None:
    assert isinstance(make_runtime(paper_network(), 64, 48), WordRuntime)
    assert isinstance(make_runtime(paper_network(0.5), 64, 48), TableRuntime)
    halves = replace(paper_network(), weight=np.full((32, 25), 0.5, np.float32))
    assert isinstance(make_runtime(halves, 64, 48), TableRuntime)


@pytest.mark.parametrize("l_tau", [0.0, 0.5])
def test_what_is_not_wanted_is_left_out_and_nothing_else(l_tau: float) -> None:
    network = paper_network(l_tau)
    rng = np.random.default_rng(8)
    for whole, part in zip(runtimes(network, 130, 20), runtimes(network, 130, 20), strict=True):
        left_out = 0
        for x in images(130, 20, 60, seed=7):
            wanted = rng.choice(np.array([0, 1, 8, 40], np.uint8), (20, 3))
            row, column = np.nonzero(x)
            want = {
                (cx, cy, k): s
                for (cx, cy, k), s in fed(whole, x).items()
                if wanted[cy, cx // 64] and s >= wanted[cy, cx // 64]
            }
            got = named(part.step(column, row, wanted))
            assert got == want
            left_out += len(want) == 0
        assert left_out < 30


@pytest.mark.parametrize("l_tau", [0.0, 0.5, 0.9])
def test_the_runtime_of_torch_gives_the_same_spikes_as_the_fast_ones_through_gaps_too(l_tau: float) -> None:
    pytest.importorskip("torch", reason="torch is not installed (extra [reference])")
    pytest.importorskip("nir", reason="nir is not installed (extra [reference])")
    from heliograph_services.tracker.reference.flow import runtime as torch_runtime  # noqa: PLC0415

    network = paper_network(l_tau)
    rng = np.random.default_rng(9)
    ours, reference = runtimes(network, 70, 9), torch_runtime(network, 70, 9)
    total = 0
    for t, x in enumerate(images(70, 9, 60, seed=10)):
        wanted = rng.choice(np.array([0, 1, 8], np.uint8), (9, 2)) if t % 2 else None
        row, column = np.nonzero(x)
        want = named(reference.step(column, row, wanted))
        total += len(want)
        for runtime in ours:
            assert named(runtime.step(column, row, wanted)) == want
        if t % 20 == 15:
            gap = [named(spikes) for spikes in reference.skip(4 * t)]
            for runtime in ours:
                assert [named(spikes) for spikes in runtime.skip(4 * t)][: len(gap)] == gap
    assert total > 500
