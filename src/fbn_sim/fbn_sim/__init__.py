"""Simulates the world, the vehicle and its sensors, with effects that no estimator models."""
