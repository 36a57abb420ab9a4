"""Start the node: ``ros2 launch hd_diag hd_diag.launch.py params_file:=drive.yaml [namespace:=arm]``."""

import re
import tempfile
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

NODE_NAME = "hd_diag"


def parameters_for(namespace: str, params_file: str) -> str:
    """Parameter file whose top key names the node in its namespace.

    A file headed ``hd_diag:`` applies to ``/hd_diag`` only; in a namespace ROS would ignore it
    silently. Only the key is replaced, so that every number stays as written.
    """
    if not namespace.strip("/"):
        return params_file
    text = Path(params_file).read_text(encoding="utf-8")
    text = re.sub(rf"(?m)^/?{NODE_NAME}:", f"/{namespace.strip('/')}/{NODE_NAME}:", text, count=1)
    with tempfile.NamedTemporaryFile("w", prefix="hd_diag_", suffix=".yaml", delete=False) as copy:
        copy.write(text)
    return copy.name


def start_node(context: LaunchContext) -> list[Node]:
    """Node action with the arguments as given on the command line."""
    namespace = context.perform_substitution(LaunchConfiguration("namespace"))
    params_file = context.perform_substitution(LaunchConfiguration("params_file"))
    log_level = context.perform_substitution(LaunchConfiguration("log_level"))
    node = Node(
        package="hd_diag",
        executable="hd_diag_node",
        name=NODE_NAME,
        namespace=namespace,
        parameters=[parameters_for(namespace, params_file)],
        arguments=["--ros-args", "--log-level", log_level],
        output="screen",
    )
    return [node]


def generate_launch_description() -> LaunchDescription:
    """Launch description with the arguments params_file, namespace and log_level."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file", description="ROS parameter file with the drive of each joint"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
            DeclareLaunchArgument("log_level", default_value="info", description="lowest severity printed"),
            OpaqueFunction(function=start_node),
        ]
    )
