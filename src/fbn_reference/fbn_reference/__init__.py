"""Absolute position and the parameters of vehicle and water, from GPS and acoustic beacons."""
