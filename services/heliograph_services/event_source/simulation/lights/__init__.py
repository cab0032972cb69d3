"""What makes lights bright and dark: beacons with their frames, lamps and blinkers, edges from outside."""
