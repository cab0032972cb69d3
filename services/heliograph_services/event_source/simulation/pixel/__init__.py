"""The pixels: from light to events, by published laws."""
