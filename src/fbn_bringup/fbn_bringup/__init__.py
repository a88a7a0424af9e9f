"""Launch files, vehicle parameters and the fbn command: demo, replay, report, viewer."""
