"""The world: what a scenario says (`spec`), where things are, what the camera sees of every light."""
