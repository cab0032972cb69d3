"""The decoder of Wang et al. (2022) without a state machine: all strong samples first, then bits looked up in them."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from math import exp, pi

from heliograph.link.wang2022 import WangParameters


def strong_samples(t_us: list[int], on: list[bool], bit_us: float, p: WangParameters) -> list[tuple[int, int]]:
    """Return (time, value) of the strong samples."""
    tau_us = bit_us / (2 * pi * p.cutoff)
    total, before, out = 0.0, t_us[0] if t_us else 0, []
    for t, is_on in zip(t_us, on, strict=True):
        total = total * exp(-(t - before) / tau_us) + (p.step if is_on else -p.step)
        before = t
        if total > p.upper or total < p.lower:
            out.append((t, int(total > p.upper)))
    return out


def characters(t_us: list[int], on: list[bool], bit_us: float, p: WangParameters) -> list[tuple[int, int]]:
    """Return (time of the end, character) of all that is read if silence follows."""
    samples = strong_samples(t_us, on, bit_us, p)
    times = [t for t, _ in samples]
    before = [1, *(value for _, value in samples)]
    falls = [t for a, (t, b) in zip(before, samples, strict=False) if a == 1 and b == 0]
    out, armed = [], float("-inf")
    while (at := bisect_left(falls, armed)) < len(falls):
        start = falls[at]
        code = 0
        for k in range(1, 8):
            middle = start + (k + p.middle) * bit_us
            near = [v for t, v in samples[bisect_left(times, middle - bit_us) : bisect_right(times, middle + bit_us)]
                    if abs(t - middle) < p.window * bit_us]  # fmt: skip
            vote = 2 * sum(near) - len(near)
            held = samples[bisect_right(times, middle) - 1][1]
            code = 2 * code + (held if vote == 0 else int(vote > 0))
        out.append((round(start + 11 * bit_us), code))
        # A start is taken only once the first stop bit's window has passed.
        armed = start + (9 + p.middle + p.window) * bit_us
    return out
