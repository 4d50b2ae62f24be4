"""What gelform talks to, the real thing: ROS 2 by rclpy, LeRobot's own writer and reader, and Ray. Each writes its results.

    PYTHON benchmarks/counterparts.py ros             # a Python with rclpy and the extra ros
        --seconds 10                                  # of each measurement
    PYTHON benchmarks/counterparts.py lerobot         # a Python 3.12 or newer
        --environment DIR                             # with LeRobot (5.5 GB), made if it is not there
    PYTHON benchmarks/counterparts.py ray             # a Python with the extra ray; real frames (GELFORM_DATA)

The age of a message is from the capture of its frame to the subscriber's callback, which has the message decoded. Every
topic has a subscriber. The source is the simulated sensor at 60 Hz; its images take a part of the processor, too, above all
those without noise, which are computed once, in the first seconds, before the measurement.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gelform.robots.topics import TOPICS, USUAL
from report import command_line, parts_asked, table, write_part

ROOT = Path(__file__).parents[1]
RUN = "from gelform_ros.node import main; main()"
SETTINGS = {
    "everything": (tuple(TOPICS), ["topics:=" + ",".join(TOPICS)]),
    "usual": (USUAL, []),
    "depth_only": (("indentation", "diagnostics"), ["depth_only:=true"]),
}
WARM_S = 15.0  # from the first message, until the simulated sensor has computed its images
WRONG = ["calibration:=none.npz", "source:=no_such_camera", "topics:=depth", "rate:=fast"]


def node_of(calibration: Path, *parameters: str) -> subprocess.Popen[str]:
    """The process of a node of the simulated sensor."""
    given = [f"calibration:={calibration}", "source:=simulated", "name:=finger", *parameters]
    command = [sys.executable, "-c", RUN, "--ros-args", *(word for one in given for word in ("-p", one))]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def heard(
    calibration: Path, topics: tuple[str, ...], parameters: list[str], seconds: float
) -> dict[str, Any]:
    """Rate and age of indentation at a subscriber of these topics; how the node ended by Ctrl-C."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    ages_ms: list[float] = []

    def callback(message: Any) -> None:
        stamp = message.header.stamp
        ages_ms.append(1e3 * (time.time() - stamp.sec) - stamp.nanosec / 1e6)

    context = rclpy.Context()
    rclpy.init(context=context)
    subscriber = rclpy.create_node("counterpart", context=context)
    for name in topics:
        package, kind = TOPICS[name].type.split("/msg/")
        hear = callback if name == "indentation" else lambda message: None
        subscriber.create_subscription(
            getattr(import_module(f"{package}.msg"), kind), TOPICS[name].of("finger"), hear, 10
        )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(subscriber)
    node = node_of(calibration, *parameters)

    def spin(until_s: float, least: int = 0) -> None:
        while time.monotonic() < until_s or len(ages_ms) < least:
            executor.spin_once(timeout_sec=0.1)

    spin(0, 1)
    spin(time.monotonic() + WARM_S)
    ages_ms.clear()
    start_s, before_s, own_s = time.monotonic(), processor_s(node.pid), time.process_time()
    spin(start_s + seconds)
    rate_hz = len(ages_ms) / (time.monotonic() - start_s)
    used_ms = 1e3 * (processor_s(node.pid) - before_s) / len(ages_ms)
    own_ms = 1e3 * (time.process_time() - own_s) / len(ages_ms)
    node.send_signal(signal.SIGINT)
    said = node.communicate(timeout=60)[0]
    rclpy.shutdown(context=context)
    return {
        "rate_hz": round(rate_hz, 1),
        "processor_ms_per_result": round(used_ms, 1),
        "subscriber_ms_per_result": round(own_ms, 1),
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
            name: heard(calibration, topics, given, seconds) for name, (topics, given) in SETTINGS.items()
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


def lerobot(environment: Path) -> dict[str, Any]:
    """What the tests of the camera plugin say with LeRobot's own factory, writer and reader, and the versions there."""
    script = ROOT / "integrations" / "lerobot_camera_gelform" / "test.sh"
    said = subprocess.run([script, environment], capture_output=True, text=True, check=False)
    found = re.findall(r"(\d+) (passed|failed|skipped|error)", said.stdout.splitlines()[-1])
    if not found:
        raise SystemExit(f"{script} ran no test:\n{said.stdout[-2000:]}{said.stderr[-2000:]}")
    ask = "import platform, importlib.metadata as m; print(platform.python_version(), *map(m.version, ('lerobot', 'torch')))"
    versions = subprocess.run(
        [environment / "bin" / "python", "-c", ask], capture_output=True, text=True, check=True
    )
    return {
        "status": said.returncode,
        **{what: int(count) for count, what in found},
        "versions": dict(zip(("python", "lerobot", "torch"), versions.stdout.split())),
    }


def ray() -> dict[str, Any]:
    """Whether `gelform batch` gives the same bytes by Ray as by the pool of processes, on real frames."""
    data = Path(os.environ.get("GELFORM_DATA", ROOT.parent / "shared" / "data")) / "mini-edge"
    with tempfile.TemporaryDirectory() as folder:
        frames, outputs = Path(folder) / "frames", {}
        frames.mkdir()
        for image in sorted((data / "images").glob("*.png"))[:25]:
            shutil.copy(image, frames)
        start = ["--background", str(data / "background.png")]
        run = [sys.executable, "-m", "gelform"]
        calibration = str(Path(folder) / "cal.npz")
        subprocess.run([*run, "starter", "gelsight-mini", "-o", calibration, *start], check=True)
        for engine in ("pool", "ray"):
            outputs[engine] = Path(folder) / engine
            options = [
                "-o",
                str(outputs[engine]),
                "--engine",
                engine,
                "--workers",
                "2",
                "--quiet",
                "--accept-doubtful",
            ]
            subprocess.run([*run, "batch", str(frames), "-c", calibration, *options], check=True)
        files = {engine: results_in(path) for engine, path in outputs.items()}
    return {
        "frames": len(files["pool"]),
        "names_are_equal": files["pool"].keys() == files["ray"].keys(),
        "files_that_differ": [
            name for name, content in files["pool"].items() if files["ray"].get(name) != content
        ],
        "versions": {"ray": version("ray")},
    }


def results_in(folder: Path) -> dict[str, bytes]:
    """The bytes of each result in a folder of a batch."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.npz"))}


def main() -> None:
    """Measure the parts, print the tables, write the figures."""
    command = command_line(__doc__)
    command.add_argument("--seconds", type=float, default=10.0)
    command.add_argument("--environment", type=Path)
    asked = parts_asked(command, ["ros", "lerobot", "ray"])
    if "lerobot" in asked.parts and asked.environment is None:
        command.error("lerobot needs --environment DIR, a folder for 5.5 GB outside of the checkout")
    if "ros" in asked.parts:
        show_ros(figures := ros(asked.seconds))
        write_part("counterparts", "ros", figures)
    for name in ("lerobot", "ray"):
        if name in asked.parts:
            figures = lerobot(asked.environment.absolute()) if name == "lerobot" else ray()
            print(table((name, "value"), [(key, str(value)) for key, value in figures.items()]))
            write_part("counterparts", name, figures)


def show_ros(figures: dict[str, Any]) -> None:
    """Print the table of the node."""
    rows = [
        (
            f"{name}: results a second, age in ms: median, 95 %; processor, ms a result, and the subscriber's",
            figures[name]["rate_hz"],
            *figures[name]["age_ms"].values(),
            figures[name]["processor_ms_per_result"],
            figures[name]["subscriber_ms_per_result"],
        )
        for name in SETTINGS
    ]
    print(
        table(
            ("figure", "rate", "median", "95 %", "ms", "ms"),
            [*rows, ("tracebacks", figures["tracebacks"], "", "", "", "")],
        )
    )


if __name__ == "__main__":
    main()
