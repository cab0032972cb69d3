"""Counts, refusals and accuracy of a running site, kept in a file."""
