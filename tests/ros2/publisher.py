"""A sensor in a process of its own: a cloud ten times a second until it is killed."""

from __future__ import annotations

import time

import rclpy
from peer import RELIABLE, cloud_of, cross
from sensor_msgs.msg import PointCloud2


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("sensor")
    cloud = node.create_publisher(PointCloud2, "cloud", RELIABLE)
    while rclpy.ok():
        cloud.publish(cloud_of(cross(), time.time_ns(), "lidar"))
        time.sleep(0.1)


if __name__ == "__main__":
    main()
