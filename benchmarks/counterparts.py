"""What gelform talks to, the real thing: its node of ROS 2 and a subscriber in another process, by rclpy.

    PYTHON benchmarks/counterparts.py ros             # a Python with rclpy and the extra ros; writes its results
        --seconds 10                                  # of each measurement

The age of a message is from the capture of its frame to the subscriber's callback, which has the message decoded. The source
is the simulated sensor at 60 Hz, whose images take a part of the processor, too.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from report import command_line, parts_asked, table, write_part

ROOT = Path(__file__).parents[1]
RUN = "from gelform_ros.node import main; main()"
SETTINGS = {
    "everything": ["topics:=image,compressed,indentation,points,wrench,pose,diagnostics"],
    "usual": [],
    "depth_only": ["depth_only:=true"],
}
WRONG = ["calibration:=none.npz", "source:=no_such_camera", "topics:=depth", "rate:=fast"]


def node_of(calibration: Path, *parameters: str) -> subprocess.Popen[str]:
    """The process of a node of the simulated sensor."""
    given = [f"calibration:={calibration}", "source:=simulated", "name:=finger", *parameters]
    command = [sys.executable, "-c", RUN, "--ros-args", *(word for one in given for word in ("-p", one))]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def heard(calibration: Path, parameters: list[str], seconds: float) -> dict[str, Any]:
    """Rate and age of indentation at a subscriber, after two seconds; how the node ended by Ctrl-C."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import Image

    ages_ms: list[float] = []

    def callback(message: Any) -> None:
        stamp = message.header.stamp
        ages_ms.append(1e3 * (time.time() - stamp.sec) - stamp.nanosec / 1e6)

    context = rclpy.Context()
    rclpy.init(context=context)
    subscriber = rclpy.create_node("counterpart", context=context)
    subscriber.create_subscription(Image, "/finger/indentation", callback, 10)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(subscriber)
    node = node_of(calibration, *parameters)

    def spin(until_s: float, least: int = 0) -> None:
        while time.monotonic() < until_s or len(ages_ms) < least:
            executor.spin_once(timeout_sec=0.1)

    spin(0, 1)
    spin(time.monotonic() + 2)
    ages_ms.clear()
    start_s, before_s = time.monotonic(), processor_s(node.pid)
    spin(start_s + seconds)
    rate_hz = len(ages_ms) / (time.monotonic() - start_s)
    used_ms = 1e3 * (processor_s(node.pid) - before_s) / len(ages_ms)
    node.send_signal(signal.SIGINT)
    said = node.communicate(timeout=60)[0]
    rclpy.shutdown(context=context)
    return {
        "rate_hz": round(rate_hz, 1),
        "processor_ms_per_result": round(used_ms, 1),
        "age_ms": {
            "median": round(float(np.median(ages_ms)), 1),
            "95": round(float(np.quantile(ages_ms, 0.95)), 1),
        },
        "status": node.returncode,
        "traceback": "Traceback" in said,
    }


def processor_s(pid: int) -> float:
    """The time of processors that a process of Linux has used, its simulated sensor included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def ros(seconds: float) -> dict[str, Any]:
    """The figures of the node with each of the settings, and its tracebacks on bad input and at its end."""
    from gelform.calibration.library import choose_calibration, unit_of

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT / "integrations" / "ros2"), *filter(None, sys.path)])
    with tempfile.TemporaryDirectory() as folder:
        calibration = Path(folder) / "cal.npz"
        choose_calibration(unit_of("simulated")).calibration.save(calibration)
        figures: dict[str, Any] = {
            name: heard(calibration, given, seconds) for name, given in SETTINGS.items()
        }
        wrong = [node_of(calibration, one) for one in WRONG]
        said = [one.communicate(timeout=120)[0] for one in wrong]
    tracebacks = sum("Traceback" in one for one in said) + sum(
        figures[name]["traceback"] for name in SETTINGS
    )
    return figures | {
        "tracebacks": tracebacks,
        "statuses_of_bad_input": [one.returncode for one in wrong],
        "load": round(os.getloadavg()[0], 1),
        "wheels": {name: version(f"ros-{name}") for name in ("rclpy", "rmw-fastrtps-cpp", "sensor-msgs")},
    }


def main() -> None:
    """Measure the parts, print the table, write the figures."""
    command = command_line(__doc__)
    command.add_argument("--seconds", type=float, default=10.0)
    asked = parts_asked(command, ["ros"])
    figures = ros(asked.seconds)
    rows = [
        (
            f"{name}: results a second, age in ms: median, 95 %; processor, ms a result",
            figures[name]["rate_hz"],
            *figures[name]["age_ms"].values(),
            figures[name]["processor_ms_per_result"],
        )
        for name in SETTINGS
    ]
    print(
        table(
            ("figure", "rate", "median", "95 %", "ms"),
            [*rows, ("tracebacks", figures["tracebacks"], "", "", "")],
        )
    )
    write_part("counterparts", "ros", figures)


if __name__ == "__main__":
    main()
