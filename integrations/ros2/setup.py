from setuptools import setup

setup(
    name="gelform_ros",
    version="0.1.0",
    packages=["gelform_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gelform_ros"]),
        ("share/gelform_ros", ["package.xml"]),
        ("share/gelform_ros/launch", ["launch/two_fingers.launch.xml"]),
    ],
    install_requires=["setuptools", "gelform[ros]"],
    entry_points={"console_scripts": ["node = gelform_ros.node:main"]},
)
