"""What every heliograph process shares: events, messages, keys, the optical link, and the shell that runs a core."""

__version__ = "0.1.0"
