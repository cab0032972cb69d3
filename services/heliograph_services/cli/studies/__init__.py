"""Studies: simulated scenes read by the real cores in one process, scored against the truth."""
