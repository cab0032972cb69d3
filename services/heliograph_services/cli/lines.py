"""The JSON lines of the command line: the same for a recording in one process and for a site on the bus.

One object a line, its `type` first: `identification`, `message`, `frame`, `link`, `summary`. Fields as in
`docs/wire.md`.
"""

from __future__ import annotations

import json
from typing import Any

from heliograph.messages import Data, Frames, Identification, Link, Message


def identification_line(message: Identification) -> dict[str, Any]:
    """Return the line of an identification; `change` says why it is sent."""
    return {
        "type": "identification",
        "t_us": message.t_us,
        "camera": message.camera,
        "track": message.track,
        "protocol": message.protocol,
        "beacon": message.beacon,
        "payload": message.payload,
        "x_px": message.x_px,
        "y_px": message.y_px,
        "bearing": message.bearing,
        "confidence": message.confidence,
        "margin": message.margin,
        "frames_used": message.frames_used,
        "change": message.change,
        "lost": message.lost,
        "duplicates": message.duplicates,
    }


def data_line(message: Data) -> dict[str, Any]:
    """Return the line of a message: text, or data as hex."""
    line = {
        "type": "message",
        "t_us": message.t_us,
        "camera": message.camera,
        "track": message.track,
        "protocol": message.protocol,
        "beacon": message.beacon,
    }
    if message.text is not None:
        return line | {"text": message.text}
    return line | {"data": (message.data or b"").hex()}


def frame_lines(message: Frames) -> list[dict[str, Any]]:
    """Return a line for each frame."""
    return [
        {
            "type": "frame",
            "t_us": message.t_us[i],
            "camera": message.camera,
            "track": message.track[i],
            "protocol": message.protocol[i],
            "beacon": message.beacon[i],
            "payload": message.payload[i],
            "x_px": message.x_px[i],
            "y_px": message.y_px[i],
            "confidence": message.score[i],
        }
        for i in range(len(message.t_us))
    ]


def link_line(message: Link) -> dict[str, Any]:
    """Return the line of how well a track is read."""
    return {
        "type": "link",
        "t_us": message.t_us,
        "camera": message.camera,
        "track": message.track,
        "protocol": message.protocol,
        "bit_rate": message.bit_rate,
        "snr_db": message.snr_db,
        "jitter_us": message.jitter_us,
        "clock_ppm": message.clock_ppm,
        "events_per_transition": message.events_per_transition,
        "mar_estimate": message.mar_estimate,
    }


def lines_of(message: Message, *, frames: bool, refreshed: bool = False, links: bool = False) -> list[dict[str, Any]]:
    """Return the lines of a record; none for records that are not for the reader.

    Args:
        message: any record.
        frames: whether frames are wanted.
        refreshed: whether identifications are wanted that only repeat a state.
        links: whether it is wanted how well tracks are read.
    """
    if isinstance(message, Identification):
        return [identification_line(message)] if refreshed or message.change != "refreshed" else []
    if isinstance(message, Data):
        return [data_line(message)]
    if isinstance(message, Frames) and frames:
        return frame_lines(message)
    if isinstance(message, Link) and links:
        return [link_line(message)]
    return []


def dump(line: dict[str, Any]) -> str:
    """Return a line as JSON text."""
    return json.dumps(line, ensure_ascii=False, separators=(", ", ": "))


def _notes(line: dict[str, Any]) -> str:
    """Return the confidence; instead of it, where another light sends the same ID, that light's track."""
    others = line["duplicates"]
    return f"also {others[0]}" if line["change"] == "duplicate" and others else f"{line['confidence']:.2f}"


def _shown(value: float | None, form: str) -> str:
    """Return a number in its form, or as wide a dash."""
    return format(value, form) if value is not None else "-".rjust(len(format(0.0, form)))


def for_people(line: dict[str, Any]) -> str:
    """Return a line as a person reads it, for a terminal of 80 columns."""
    t_s = line["t_us"] / 1e6
    if line["type"] == "identification":
        return (
            f"{t_s:11.3f} s  {line['beacon']:<20.20} {line['change']:<9} at ({line['x_px']:7.1f}, {line['y_px']:6.1f})"
            f"  {_notes(line)}"
        )
    if line["type"] == "message":
        text = line.get("text")
        shown = json.dumps(text, ensure_ascii=False) if text is not None else line["data"]
        return f"{t_s:11.3f} s  {line['beacon'] or line['protocol']:<12.12} {shown}"
    if line["type"] == "link":
        return (
            f"{t_s:11.3f} s  {line['track']:<12.12} {_shown(line['snr_db'], '5.1f')} dB  jitter"
            f" {_shown(line['jitter_us'], '5.0f')} us  clock {_shown(line['clock_ppm'], '+6.0f')} ppm"
            f"  MAR {_shown(line['mar_estimate'], '.2f')}"
        )
    return f"{t_s:11.3f} s  {line['track']:<12.12} frame {line['protocol']}:{line['payload']} {line['confidence']:.2f}"
