"""Which receivers are compared, and how those that have parameters are tuned.

*Tuned* is tuned in hindsight, for each section and condition apart, on trials of development seeds: more than an
operator could do, who does not know what is wrong with his light. Chosen is what reads most frames right; of equals
what reads fewest wrong, then the first in the grid. Ours has one setting for everything and is not tuned.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Final

from heliograph.link.modulations import modulation
from heliograph.link.paper import PaperParameters, PaperReceiver
from heliograph.link.wang2022 import WangParameters, WangReceiver, published
from heliograph_services.cli.link_light import Damage
from heliograph_services.cli.link_trials import Make, Section, hear, make_trial, matched

DEVELOPMENT_SEEDS: Final = (0, 1, 2, 3)
# One feed a trial: results do not depend on how the input is cut, and tuning is not timed.
_WHOLE_US: Final = 1 << 40

Parameters = PaperParameters | WangParameters


# Its rows are those of cli/link_genie.py.
GENIE: Final = "genie"


@dataclass(frozen=True, slots=True)
class Contender:
    """A receiver in the comparison: its name in tables, the modulation's name of it, and whether it is tuned."""

    name: str
    receiver: str
    tuned: bool = False


CONTENDERS: Final = {
    "seed11": (
        Contender("ours", "default"),
        Contender("paper", "paper"),
        Contender("paper, tuned", "paper", tuned=True),
        Contender("binning", "binning"),
        Contender(GENIE, GENIE),
    ),
    "uart": (
        Contender("ours", "default"),
        Contender("wang2022", "wang2022"),
        Contender("wang2022, tuned", "wang2022", tuned=True),
        Contender(GENIE, GENIE),
    ),
}


def grid(section: Section, contender: Contender) -> Iterator[Parameters]:
    """Yield the parameters that are tried for a contender, the published ones first."""
    if contender.receiver == "paper":
        yield PaperParameters()
        for window, polarity, events in product((1.0, 0.75, 0.5, 0.25), (0.5, 0.25), (5, 2, 15)):
            yield PaperParameters(window, polarity, events)
        return
    was = published(section.bit_rate)
    yield was
    for times, cutoff, middle in product((1.0, 0.25, 0.5, 2.0, 4.0, 8.0), (1 / 3, 1 / 6, 2 / 3, 1.0), (0.5, 0.6)):
        yield WangParameters(was.upper * times, was.lower * times, cutoff, middle=middle)


def maker(section: Section, contender: Contender, parameters: Parameters | None = None) -> Make:
    """Return what makes a fresh receiver; parameters: of a tuned one."""
    link = modulation(section.protocol)
    if isinstance(parameters, PaperParameters):
        code = link.code  # type: ignore[attr-defined]  # cyclic ones have it
        return lambda: PaperReceiver(code, section.bit_rate, parameters)
    if isinstance(parameters, WangParameters):
        return lambda: WangReceiver(section.bit_rate, parameters)
    return lambda: link.receiver(section.bit_rate, contender.receiver)


def tune(section: Section, contender: Contender, damage: Damage, seconds: float) -> Parameters:
    """Return the parameters that read most frames of the development trials right."""
    trials = [make_trial(section, damage, seconds, seed) for seed in DEVELOPMENT_SEEDS]
    best: tuple[tuple[int, int], Parameters] | None = None
    for parameters in grid(section, contender):
        make = maker(section, contender, parameters)
        right = published = 0
        for trial in trials:
            frames, _ = hear(make(), trial.seen, _WHOLE_US)
            partner, _ = matched(trial.frames, frames)
            right += sum(trial.frames[i].payload == got.payload for i, got in partner.items())
            published += len(frames)
        merit = (right, -published)
        if best is None or merit > best[0]:
            best = merit, parameters
    assert best is not None  # noqa: S101 - a grid is never empty
    return best[1]


def plain(parameters: Parameters | None) -> dict[str, float]:
    """Return parameters for JSON."""
    return {} if parameters is None else {name: round(float(value), 4) for name, value in asdict(parameters).items()}
