"""Writes what a camera sees, with who is where on it: python overlay.py FOLDER tcp/127.0.0.1:7447

Needs eclipse-zenoh, msgpack and pillow. A source whose `image_hz` is set sends images; PNGs are named by their time.
"""

import json
import sys
import zlib
from pathlib import Path

import msgpack
import zenoh
from PIL import Image, ImageDraw

STALE_US = 1_000_000  # ten refreshments of an identification have not come
SIDE_PX = 9  # half of a box
COLOURS = ("#ffb000", "#00d0ff", "#ff4f8b", "#7bd800")


class Overlay:
    """Keeps who is there, and draws it on images."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, str], dict] = {}

    def take(self, who: dict) -> None:
        """Take the body of an `ids` message."""
        key = who["camera"], who["track"]
        if who["lost"]:
            self.known.pop(key, None)
        else:
            self.known[key] = who

    def draw(self, body: dict) -> Image.Image:
        """Return the picture of the body of an `image` message, with a box and a name for each beacon."""
        size = body["width"], body["height"]
        picture = Image.frombytes("L", size, zlib.decompress(body["grey"])).convert("RGB")
        pen = ImageDraw.Draw(picture)
        for (camera, _), who in self.known.items():
            late_us = body["t_us"] - who["t_us"]
            if camera != body["camera"] or abs(late_us) > STALE_US:
                continue
            x, y = (who[f"{axis}_px"] + who[f"v{axis}_px_s"] * late_us * 1e-6 for axis in "xy")
            colour = COLOURS[zlib.crc32(who["beacon"].encode()) % len(COLOURS)]
            pen.rectangle((x - SIDE_PX, y - SIDE_PX, x + SIDE_PX, y + SIDE_PX), outline=colour)
            pen.text((x + SIDE_PX + 3, y - 6), f"{who['beacon']} {who['confidence']:.2f}", fill=colour)
        pen.text((4, 2), f"{body['camera']} {body['t_us'] * 1e-6:.3f} s", fill="white")
        return picture


def main(folder: Path, endpoints: list[str]) -> None:
    """Follow a site until interrupted."""
    folder.mkdir(parents=True, exist_ok=True)
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": endpoints}}))
    overlay = Overlay()
    with zenoh.open(config) as session:
        ids = session.declare_subscriber("heliograph/@v1/*/ids/**", zenoh.handlers.RingChannel(1000))
        images = session.declare_subscriber("heliograph/@v1/*/image/*", zenoh.handlers.RingChannel(2))
        for sample in images:
            while (who := ids.try_recv()) is not None:
                overlay.take(msgpack.unpackb(who.payload.to_bytes())["body"])
            body = msgpack.unpackb(sample.payload.to_bytes())["body"]
            path = folder / f"{body['camera']}-{body['t_us']:012d}.png"
            overlay.draw(body).save(path)
            print(path, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
