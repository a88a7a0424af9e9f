"""The report of a run: one HTML file with layers that can be switched, and PNGs for papers."""
