"""The five nodes for ``ros2 launch fbn_bringup fbn.launch.py``; all of it derived from the declared graph.

Arguments: namespace, params_file, use_sim_time, log_level.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from fbn_bringup.launching import ARGUMENTS, node_arguments


def start_nodes(context: LaunchContext) -> list[Node]:
    """One action per node; a parameter file is checked here, before anything runs."""
    chosen = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    return [Node(**arguments) for arguments in node_arguments(chosen)]


def generate_launch_description() -> LaunchDescription:
    """What ros2 launch runs."""
    declared = [DeclareLaunchArgument(a.name, default_value=a.default, description=a.about) for a in ARGUMENTS]
    on_this_host = EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST")
    return LaunchDescription(
        [
            *declared,
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", on_this_host),
            SetEnvironmentVariable("OPENBLAS_NUM_THREADS", "1"),
            SetEnvironmentVariable("OMP_NUM_THREADS", "1"),
            OpaqueFunction(function=start_nodes),
        ]
    )
