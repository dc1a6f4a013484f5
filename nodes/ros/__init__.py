"""The parts of the ROS 2 node: parameters, inputs, outputs; `nodes.ros2` puts them together."""
