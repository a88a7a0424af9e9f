"""Dead reckoning: a smooth, continuous pose that never jumps."""
