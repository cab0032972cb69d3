"""The read-outs: what the sensor's scan, bus or image clock leaves of the pixels' events; presets of sensors."""
