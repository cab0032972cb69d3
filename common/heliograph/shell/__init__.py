"""The shell: all that knows Zenoh, signals and the wall clock; it runs a pure core as a process."""
