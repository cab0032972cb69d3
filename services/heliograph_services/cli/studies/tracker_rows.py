"""One run of the tracker's study as a plain row, ready for a line of JSON.

Frames are counted in blocks of one beacon and one second, in two classes: `out` outside close pairs, `in` inside. A
block is a list [beacon, second, sent, then right and wrong of each reader in their order]. `lost` tells, of the frames
that count and were not read right by us, how many had no track near (`untracked`) and how many the genie missed too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib import resources
from itertools import pairwise
from typing import Any, Final

import msgspec
import numpy as np

from heliograph.messages import Tracks
from heliograph_services.cli.studies import crowds, holding
from heliograph_services.cli.studies.running import Episode, Reader, Said, Setting, episode
from heliograph_services.cli.studies.tracking_truth import sample, score
from heliograph_services.cli.studies.verdicts import RIGHT, WRONG, Sent, Verdicts, sent_frames, tracked, verdicts
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons

Row = dict[str, Any]

# Tracks of a grid of 10 ms or more lie on ends of it: nothing is interpolated.
TRUTH_US: Final = 10_000
# Of `spin`, px/s.
SPEEDS: Final = (0, 1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000, 9000, 10_000, 11_500)
PAIR: Final[tuple[Reader, ...]] = ("ours", "genie")


def moving(
    seed: int, sensor: str, move: str, bit_rate: float, seconds: float, background: str, readers: Sequence[Reader]
) -> Row:
    """Return the row of 20 beacons with a new payload for every frame: MAR, beside the genie's."""
    script = crowds.moving(seed, sensor, move, bit_rate, seconds, fresh=True, texture=background == "texture")
    return frames_row(episode(_setting(script.text, seed, seconds, bit_rate), readers))


def identities(seed: int, sensor: str, move: str, bit_rate: float, seconds: float, background: str) -> Row:
    """Return the row of 20 beacons with payloads of their own: swaps, acquisition, the tracks' scores."""
    script = crowds.moving(seed, sensor, move, bit_rate, seconds, fresh=False, texture=background == "texture")
    return _identities_row(episode(_setting(script.text, seed, seconds, bit_rate)))


def crowd(seed: int, seconds: float) -> Row:
    """Return the row of the built-in `crowd`."""
    decoder = {"protocol": "code", "bit_rate": 1000.0, "options": {"codebook": "code20d4"}}
    said = episode(Setting("crowd", seed, seconds, decoder, source={"fidelity": "live"}))
    return frames_row(said) | _identities_row(said)


def crossing(seed: int, kind: str, bit_rate: float) -> Row:
    """Return the row of two beacons that cross."""
    script = crowds.crossing(seed, kind, bit_rate)
    said = episode(_setting(script.text, seed, script.seconds, bit_rate))
    ours = said.said["ours"]
    counts = holding.held(ours, said.paths)
    return holding.crossing(ours, said.paths) | {"swaps": counts.swaps, **script.about, **_cost(said)}


def occlusions(seed: int, motion: str, camera: str, bit_rate: float) -> Row:
    """Return the row of some beacons that are each hidden once for half a second."""
    script = crowds.occlusions(seed, turning=motion == "turning", panning=camera == "panning", bit_rate=bit_rate)
    said = episode(_setting(script.text, seed, script.seconds, bit_rate))
    beacons = [holding.occlusion(said.said["ours"], said.paths, i) for i in range(len(said.paths.beacons))]
    return {"beacons": beacons, **_cost(said)}


def handheld(seed: int, seconds: float) -> Row:
    """Return the row of the built-in `handheld`: its own payloads and texts, listed."""
    listed = msgspec.to_builtins(site_beacons(load_scenario("handheld")))
    said = episode(Setting("handheld", seed, seconds, {"beacons": listed}, source={"fidelity": "live"}), PAIR)
    counts = holding.held(said.said["ours"], said.paths)
    return frames_row(said) | {"nowhere": counts.nowhere, "confused": counts.confused}


def spin(seed: int, seconds: float) -> Row:
    """Return the row of the built-in `spin`, its payload drawn anew for every frame: counts by speed."""
    folder = resources.files("heliograph_services.event_source.simulation.world") / "scenarios"
    text = (folder / "spin.toml").read_text(encoding="utf-8").replace("payload = 42", "fresh = true")
    said = episode(_setting(text, seed, seconds, 1000.0), PAIR)
    sent = sent_frames(said.truths, said.paths)
    found = {name: verdicts(sent, one.frames, said.paths) for name, one in said.said.items()}
    near = tracked(sent, said.said["ours"].tracks, said.paths, carried=False)
    bins = []
    for low, high in pairwise(SPEEDS):
        of = sent.visible & (sent.speed_px_s >= low) & (sent.speed_px_s < high)
        seconds_of = (sent.t1_us[of] // 1_000_000).tolist()
        blocks = {second: [0] * (2 + len(found)) for second in seconds_of}
        for k, second in zip(np.flatnonzero(of).tolist(), seconds_of, strict=True):
            each = [int(one.outcome[k] == RIGHT) for one in found.values()]
            blocks[second] = [a + b for a, b in zip(blocks[second], [1, int(near[k]), *each], strict=True)]
        bins.append({"px_s": [low, high], "blocks": [[second, *counts] for second, counts in blocks.items()]})
    return {"readers": list(found), "bins": bins, **_cost(said)}


RUNS: Final[dict[str, Callable[..., Row]]] = {
    "moving": moving,
    "identities": identities,
    "crowd": crowd,
    "crossings": crossing,
    "occlusions": occlusions,
    "handheld": handheld,
    "spin": spin,
}


def _setting(text: str, seed: int, seconds: float, bit_rate: float) -> Setting:
    return Setting(text, seed, seconds, {"protocol": "seed11", "bit_rate": bit_rate}, source={"fidelity": "live"})


def _cost(said: Episode) -> Row:
    readers = {name: round(one.cpu_s, 2) for name, one in said.said.items()}
    return {
        "seconds": said.seconds,
        "events_s": round(said.events / said.seconds),
        "cpu_s": {"source": round(said.source_cpu_s, 2), **readers},
    }


def frames_row(said: Episode) -> Row:
    """Return the counts of frames, by block, class and reader."""
    sent = sent_frames(said.truths, said.paths)
    found = {name: verdicts(sent, one.frames, said.paths) for name, one in said.said.items()}
    row: Row = {"readers": list(found)}
    for name, of in (("out", sent.visible & ~sent.close), ("in", sent.visible & sent.close)):
        row[name] = _blocks(sent, of, list(found.values()))
    ours = found["ours"]
    missed = sent.visible & ~sent.close & (ours.outcome != RIGHT)
    near = tracked(sent, said.said["ours"].tracks, said.paths)
    row["lost"] = {"frames": int(missed.sum()), "untracked": int((missed & ~near).sum())}
    if "genie" in found:
        row["lost"]["genie_too"] = int((missed & (found["genie"].outcome != RIGHT)).sum())
    row["published"] = {name: [one.published, one.insertions] for name, one in found.items()}
    right = ours.outcome == RIGHT
    row["frame_px2"] = [round(float(np.square(ours.off_px[right]).sum()), 3), int(right.sum())]
    return row | _tracks_row(said) | _cost(said)


def _blocks(sent: Sent, of: np.ndarray[Any, np.dtype[np.bool_]], found: Sequence[Verdicts]) -> list[list[int]]:
    which = np.flatnonzero(of)
    key = np.stack([sent.beacon[which], sent.t1_us[which] // 1_000_000], axis=1)
    unique, at = np.unique(key, axis=0, return_inverse=True)
    at = at.reshape(-1)
    columns = [np.bincount(at, minlength=len(unique))]
    for one in found:
        columns += [
            np.bincount(at, one.outcome[which] == what, len(unique)).astype(np.int64) for what in (RIGHT, WRONG)
        ]
    return [[*map(int, name), *map(int, counts)] for name, *counts in zip(unique, *columns, strict=True)]


def _tracks_row(said: Episode) -> Row:
    """Return the tracks' scores against visible beacons: of all tracks, and of the valid ones."""
    until_us = round(said.seconds * 1e6) // TRUTH_US * TRUTH_US
    truths = said.paths.truths(said.truths[0], TRUTH_US, until_us)
    row: Row = {}
    for name, keep in (("all", None), ("valid", "valid")):
        found = score(truths, [sample(_only(one, keep)) for one in said.said["ours"].tracks])
        row[f"tracks_{name}"] = {
            "clear": asdict(found.clear),
            "identity": asdict(found.identity),
            "gospa_px": round(found.gospa_px, 4),
            "instants": found.instants,
            "lag_us": None if np.isnan(found.lag_us) else round(found.lag_us),
        }
    row["names"] = len({name for one in said.said["ours"].tracks for name in one.track})
    return row


def _only(tracks: Tracks, status: str | None) -> Tracks:
    if status is None:
        return tracks
    kept = [i for i, word in enumerate(tracks.status) if word == status]
    columns = {name: [getattr(tracks, name)[i] for i in kept] for name in Tracks.__struct_fields__[3:]}
    return msgspec.structs.replace(tracks, **columns)


def _identities_row(said: Episode) -> Row:
    ours: Said = said.said["ours"]
    counts = holding.held(ours, said.paths)
    return {
        "states": {"right": counts.right, "confused": counts.confused, "nowhere": counts.nowhere},
        "swaps": counts.swaps,
        "first_us": [counts.first_us.get(name) for name in said.paths.names],
        "period_us": ours.tracks[0].period_us if ours.tracks else None,
        **_tracks_row(said),
        **_cost(said),
    }
