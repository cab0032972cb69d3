"""A genie: what the events would yield to one who knows when each frame begins, how long its bits are, and the light.

At each of a frame's bit boundaries b the events within half a bit of it, shifted by the light's mean delay of each
polarity, are counted: q_b = (N_on - N_off) / (mean of an edge). A word predicts e_b = +1, 0 or -1; its likelihood is::

    ln L = sum_b ln( (1 - d |e_b|) N(q_b - e_b; s) + d |e_b| N(q_b; s) )        N: normal density

with the spread s and the share of lost edges d measured on the truth, too. The likeliest word is the answer; nothing is
ever refused. So it is a ceiling for receivers that must find clock and alignment, as far as counts about boundaries
tell; one that looks at the events' times within half a bit may exceed it where edges are not displaced.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.link.contract import LinkFrame
from heliograph.link.modulations import modulation
from heliograph_services.cli.link_light import DELAY_US, TAU_US
from heliograph_services.cli.link_trials import Section, Trial, sendable

# Below it the spread of clean lights would make a single stray event decide.
SPREAD_MIN: Final = 0.1
LOST_RANGE: Final = (1e-3, 0.5)
# Mean of ln(D / (D - j)) over the events of 40,000 pixels: their mean delay in time constants.
_MEAN_LATE: Final = 1.17

Floats = npt.NDArray[np.float64]


def words(section: Section) -> tuple[list[int], npt.NDArray[np.int64]]:
    """Return the payloads, and (p, n) the level changes (+1, 0, -1) that their words make at the boundaries.

    What comes before a character is lit (idle time or a stop bit); before a cyclic word comes its own last bit.
    """
    link = modulation(section.protocol)
    if section.protocol == "uart":
        payloads = list(range(32, 127))
        bits = np.array([link.encode(chr(payload)) for payload in payloads])
        before = np.ones((len(payloads), 1), np.int64)
    else:
        payloads = sendable(section.protocol)
        bits = np.array([link.encode(payload) for payload in payloads])
        before = bits[:, -1:]
    return payloads, np.diff(np.concatenate([before, bits], axis=1), axis=1)


def genie(section: Section, trial: Trial) -> list[LinkFrame]:
    """Return what the genie reads of each frame."""
    if not trial.frames:
        return []
    payloads, changes = words(section)
    sums = _signed_sums(trial, changes.shape[1])
    truth = changes[[payloads.index(frame.payload) for frame in trial.frames]]
    edges = truth != 0
    mean = max(float((sums * truth)[edges].mean()), 1e-9)
    q = sums / mean
    lost = float(np.clip(np.mean(np.abs(q[edges]) < 0.3), *LOST_RANGE))
    spread = max(float(np.sqrt(np.mean(np.minimum((q - truth) ** 2, 1.0)))), SPREAD_MIN)
    likelihood = np.zeros((len(q), len(payloads)))
    for p, change in enumerate(changes):
        there = np.exp(-0.5 * ((q - change) / spread) ** 2)
        gone = np.exp(-0.5 * (q / spread) ** 2)
        share = lost * np.abs(change)
        likelihood[:, p] = np.log((1.0 - share) * there + share * gone + 1e-12).sum(axis=1)
    best = likelihood.argmax(axis=1)
    return [
        LinkFrame(round(frame.t1_us), payloads[i], 1.0, 0.0)
        for frame, i in zip(trial.frames, best.tolist(), strict=True)
    ]


def _signed_sums(trial: Trial, n: int) -> Floats:
    """Return (frames, n) of ON less OFF events within half a bit of each boundary."""
    t0 = np.array([frame.t0_us for frame in trial.frames])
    bit = np.array([frame.t1_us - frame.t0_us for frame in trial.frames]) / n
    begins = t0[:, None] + (np.arange(n) - 0.5) * bit[:, None]
    ends = begins + bit[:, None]
    sums = np.zeros((len(t0), n))
    for is_on, sign in ((True, 1.0), (False, -1.0)):
        shifted = trial.seen.t_us[trial.seen.on == is_on] - DELAY_US[is_on] - _MEAN_LATE * TAU_US[is_on]
        counts = np.searchsorted(shifted, ends) - np.searchsorted(shifted, begins)
        sums += sign * counts
    return sums
