"""What is on the air, both ways: frames, codebooks, clock recovery, likelihood.

Nothing in this package imports torch, scikit-learn, filterpy, scipy, zenoh, threads or a clock.
"""
