"""Prints who is there, then follows them: python subscribe.py tcp/127.0.0.1:7447   (eclipse-zenoh and msgpack)."""

import json
import sys

import msgpack
import zenoh.ext

config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": sys.argv[1:]}}))
with zenoh.open(config) as session:
    last, queue = zenoh.ext.HistoryConfig(max_samples=1), zenoh.handlers.RingChannel(1000)
    ids = zenoh.ext.declare_advanced_subscriber(session, "heliograph/@v1/*/ids/**", queue, history=last)
    while True:
        who = msgpack.unpackb(ids.recv().payload.to_bytes())["body"]
        print(who["beacon"], who["x_px"], who["y_px"], who["change"], flush=True)
