"""What each extra of pyproject.toml is for: a small use of every one, from a file in to a file or a message out.

    python tests/extra_uses.py mesh        # where gelform[mesh] and nothing else is installed (`.ci/extras`)

`test_release.py` runs the same uses without the extras' packages.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import threading
import urllib.request
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from gelform.cli import main
from live_waiting import answers, free_port, until
from made.files import EPISODES, KEY, write_lerobot_set
from made.small_gel import Touch, calibration, image_of, save

ROOT = Path(__file__).resolve().parents[1]
HOST = "127.0.0.1"
COUNT = 3  # frames


def command(*arguments: str) -> str:
    """What a command of gelform printed; SystemExit with its error where it fails."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(list(arguments))
        except SystemExit as stopped:
            if stopped.code:
                raise SystemExit(err.getvalue()) from None
    return out.getvalue()


def prepared(folder: Path) -> None:
    """cal.npz and frames/ of a small gel."""
    calibration().save(folder / "cal.npz")
    for k in range(COUNT):
        save(folder / "frames" / f"{k}.png", image_of(Touch(depth_mm=0.2 + 0.1 * k, seed=k)))


def batch(*more: str) -> None:
    """A batch of the frames, and its check."""
    command("batch", "frames", "-c", "cal.npz", "-o", "out", "-q", *more)
    command("batch", "verify", "out", "-q")


def surface(form: str) -> None:
    """A picture or a mesh of a frame."""
    command("reconstruct", "frames/1.png", "-c", "cal.npz", "-o", "out", "--format", form, "-q")
    assert Path(f"out/1.{form}").stat().st_size > 10_000


def use_mcap() -> None:
    command("record", "frames", "-o", "a.mcap", "-q")
    from gelform.sensors.source import open_source

    with open_source("a.mcap") as source:
        images = [frame.image for frame in source]
    assert len(images) == COUNT
    assert (images[1] == image_of(Touch(depth_mm=0.3, seed=1))).all()


def use_torch() -> None:
    from gelform.torch import Reconstruct

    import torch  # isort: skip (gelform says what is missing)

    image = torch.from_numpy(image_of(Touch())).permute(2, 0, 1)[None]
    depth_mm, _ = Reconstruct("cal.npz")(image)
    assert 0.3 < float(depth_mm.max()) < 0.5


def use_ros() -> None:
    said = json.loads(command("bag", "frames", "-c", "cal.npz", "-o", "bag", "-q", "--json"))
    assert said["frames"] == COUNT


def use_zenoh() -> None:
    from gelform.robots.send import ZenohNode

    port = free_port()
    address = f"tcp/{HOST}:{port}"
    if find_spec("zenoh") is None:
        ZenohNode("gel", router=address)
    import zenoh

    config = zenoh.Config()
    options = {"scouting/multicast/enabled": False, "mode": "router", "listen/endpoints": [address]}
    for key, value in options.items():
        config.insert_json5(key, json.dumps(value))
    heard: list[str] = []
    shown = shown_frame()
    with zenoh.open(config) as router, ZenohNode("gel", router=address) as node:
        subscription = router.declare_subscriber("0/**", lambda sample: heard.append(str(sample.key_expr)))

        def reached() -> bool:
            node.publish(shown.frame, shown.result, shown.frame.wall_time_ns)
            return any("/indentation/" in key for key in heard)

        until(reached)
        subscription.undeclare()


def use_parquet() -> None:
    batch("--table", "parquet")
    from pyarrow import parquet

    assert parquet.read_table("out/frames.parquet").num_rows == COUNT


def use_png() -> None:
    """The decompressor of the extra, where it is; else Python's own, for the same pixels."""
    from gelform.sensors.pictures import inflate, pixels_of_png

    assert inflate.__name__ == "isal.isal_zlib", "read by Python's own zlib"
    read = pixels_of_png(Path("frames/1.png").read_bytes())
    assert read is not None
    assert (read == image_of(Touch(depth_mm=0.3, seed=1))).all()


def use_lerobot() -> None:
    # Without the extra there is nothing to make one with, and the command says so.
    with contextlib.suppress(ImportError):
        write_lerobot_set(Path("set"), [image_of(Touch(seed=k)) for k in range(sum(EPISODES))])
    command("batch", "set", "--dataset", KEY, "-c", "cal.npz", "-o", "out", "--format", "lerobot", "-q")
    command("batch", "verify", "out", "-q")


def shown_frame():
    from gelform.image.view import Frame
    from gelform.live.shown import ShownFrame
    from gelform.reconstruct import Reconstructor

    image = image_of(Touch())
    result = Reconstructor(calibration()).from_image(image)
    return ShownFrame(3, Frame(image, 12.5, 10**18, 7), image, result)


def use_rerun() -> None:
    from gelform.live.sinks import RerunSink
    from gelform.live.web.server import check_extra

    port = free_port()
    if find_spec("rerun") is None:
        RerunSink(port)
    receiver = subprocess.Popen(
        [sys.executable, "-m", "rerun", "--save", "seen.rrd", "--port", str(port), "--bind", HOST]
    )
    try:
        until(lambda: answers(port))
        sink = RerunSink(port)
        check_extra()
        sink.show("sensor_0", shown_frame())
        sink.close()
        until(lambda: b"/sensor_0/depth" in Path("seen.rrd").read_bytes())
    finally:
        receiver.terminate()
        receiver.wait(20)


def use_foxglove() -> None:
    from gelform.live.sinks import FoxgloveSink
    from gelform.live.web.server import check_extra

    sink = FoxgloveSink(0)
    check_extra()
    from websockets.sync.client import connect

    sink.show("sensor_0", shown_frame())
    topics: set[str] = set()
    with connect(sink.address, subprotocols=["foxglove.sdk.v1"]) as client:
        while "/sensor_0/indentation" not in topics:
            topics |= {one["topic"] for one in json.loads(client.recv(timeout=10)).get("channels", [])}
    sink.close()


def use_live() -> None:
    from gelform.live.hub import Hub
    from gelform.live.lists import Calibrations
    from gelform.live.web.server import listen

    server = listen(port=0)
    hub = Hub(calibrations=Calibrations())
    uvicorn = server.uvicorn_of(hub)
    thread = threading.Thread(target=server.run, args=(uvicorn,), daemon=True)
    thread.start()
    until(lambda: uvicorn.started)
    with urllib.request.urlopen(server.url) as page:
        assert b"gelform" in page.read()
    uvicorn.should_exit = True
    thread.join(5)
    hub.close()


def use_docs() -> None:
    build = [sys.executable, str(ROOT / "docs/site/build.py"), str(Path("site").resolve())]
    done = subprocess.run(build, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    assert Path("site/html/index.html").exists()


USES: dict[str, Callable[[], None]] = {
    "plots": partial(surface, "png"),
    "mesh": partial(surface, "stl"),
    "zarr": partial(batch, "--format", "zarr"),
    "hdf5": partial(batch, "--format", "hdf5"),
    "ray": partial(batch, "--engine", "ray", "--workers", "2"),
    **{name[4:]: use for name, use in list(globals().items()) if name.startswith("use_")},
}
# the extras with several uses; every other use has an extra of its name
EXTRA_OF = dict.fromkeys(("zarr", "hdf5", "parquet", "lerobot"), "data") | {
    "zenoh": "ros",
    "rerun": "sinks",
    "foxglove": "sinks",
}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as work:
        for use in USES:
            if EXTRA_OF.get(use, use) == sys.argv[1]:
                folder = Path(work, use)
                folder.mkdir()
                prepared(folder)
                os.chdir(folder)
                USES[use]()
        os.chdir(ROOT)
