"""Installs the node `live` into a ROS 2 workspace."""

from setuptools import setup

NAME = "offpiste_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    entry_points={"console_scripts": [f"live = {NAME}.live_node:main"]},
)
