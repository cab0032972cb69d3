"""A message through the bus and back, on this machine alone: a router and two sessions in this process."""

from __future__ import annotations

import time
from typing import Final

from heliograph.messages import Progress
from heliograph.shell.bus import Bus, open_session
from heliograph.shell.links import client_config, router_config
from heliograph.shell.site import BusLinks, RouterLinks

SITE: Final = "doctor"
# Sent again until it arrives: a subscription takes a moment to reach the other session through the router.
_PERIOD_S: Final = 0.05


def round_trip_ms(port: int, timeout_s: float) -> float | None:
    """Return the time of a message there and its answer back; None where nothing came in time.

    Raises:
        BusError: a session cannot be opened.
        ConfigError: the links are refused.
    """
    endpoint = f"tcp/127.0.0.1:{port}"
    # Shared memory off: what is asked is whether the network works.
    links = BusLinks(connect=(endpoint,), shared_memory=False)
    router = open_session(router_config(RouterLinks(listen=(endpoint,)), links))
    if router is None:
        return None
    with router:
        here = open_session(client_config(links, wait=False))
        there = open_session(client_config(links, wait=False))
        if here is None or there is None:
            return None
        with here, there:
            return _ping(Bus(here, SITE, "doctor/here"), Bus(there, SITE, "doctor/there"), timeout_s)


def _ping(here: Bus, there: Bus, timeout_s: float) -> float | None:
    answers = here.subscribe({"progress": Progress}, {"progress": ("answer",)})
    questions = there.subscribe({"progress": Progress}, {"progress": ("question",)})
    end_s = time.monotonic() + timeout_s
    number = 0
    sent_s: dict[int, float] = {}
    try:
        while time.monotonic() < end_s:
            sent_s[number] = time.monotonic()
            here.publish(Progress(camera="question", service="doctor", t_us=number))
            number += 1
            question = questions.get(_PERIOD_S)
            opened = there.open(question) if question is not None else None
            if opened is None:
                continue
            there.publish(Progress(camera="answer", service="doctor", t_us=opened[1].time_us))
            answer = answers.get(_PERIOD_S)
            back = here.open(answer) if answer is not None else None
            if back is not None and back[1].time_us in sent_s:
                return (time.monotonic() - sent_s[back[1].time_us]) * 1e3
        return None
    finally:
        here.close()
        there.close()
