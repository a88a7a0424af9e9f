"""The one adapter between ROS and the estimators: conversions, parameters, QoS, diagnostics."""
