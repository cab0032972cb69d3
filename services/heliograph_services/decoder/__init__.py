"""From events and tracks to frames, identifications and messages."""
