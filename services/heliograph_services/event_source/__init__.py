"""From a camera to the bus: raw events for the decoder beside it, onsets for the tracker wherever it runs."""
