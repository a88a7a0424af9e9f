"""Finds where on the prior map the vehicle is, and how sure that is."""
