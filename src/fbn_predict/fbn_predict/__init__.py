"""Integrates forces and torques into the vehicle's motion between measurements."""
