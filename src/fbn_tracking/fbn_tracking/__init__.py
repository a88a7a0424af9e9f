"""Decides which sonar detections are real things, and where they lie."""
