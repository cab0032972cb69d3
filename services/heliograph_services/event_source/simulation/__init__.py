"""An ideal generator of scenes with beacons: sharp edges, discs, jitter and noise.

What it leaves out, on purpose: thresholds, time constants and refractory times of real pixels, read-out by scan or bus,
optics, background texture, occlusion. It tests the house, and says nothing about range or light.
"""
