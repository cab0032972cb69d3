"""The surroundings: textured ground, things on it, lamps that light it; as views and as images."""
