"""Maths, records and map files that every FBN package shares; free of ROS."""
