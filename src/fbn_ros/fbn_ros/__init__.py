"""The one adapter between ROS and the estimators: conversions, parameters, quality of service, diagnostics and the node base."""
