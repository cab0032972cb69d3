"""The beacon controller: the serial link to beacons, what is wanted of them and what they say of themselves."""
