"""A small HTTP server that sends given bytes, complete or torn.

A camera behind OpenCV's interface that keeps its properties and returns the pictures of a list.

Frames to record, and a camera that gives them to a grabber.

Sources of frames for tests: images at a pace, or as fast as they are read.

A tree of files as Linux shows cameras in: sys/class/video4linux, the USB devices, dev/v4l/by-path.

A small file system of its own, which fills up.

Small sensors to simulate, grids for a gel's surface and for faces, and a box as a mesh.
"""

import contextlib
import socket
import subprocess
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.image.view import Frame
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import Closing, Playback, RecordingFacts
from gelform.simulate import LAYOUTS, Coating, Gel, Led, SimulatedSensor


def jpeg(shape=(48, 64), color=(200, 30, 10), quality=95):
    """The bytes of a picture of one color (RGB), with a darker lower half."""
    image = np.empty((*shape, 3), np.uint8)
    image[:] = color[::-1]
    image[shape[0] // 2 :] //= 2
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def part(content, with_length=True, boundary="frame"):
    length = f"Content-Length: {len(content)}\r\n" if with_length else ""
    return f"--{boundary}\r\nContent-Type: image/jpeg\r\n{length}\r\n".encode() + content + b"\r\n"


SEEN = "seen"  # a piece: wait until the reader has a frame more
HEADER = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


class MjpegServer:
    """Answers each connection with a header and the pieces of a list, and keeps it open until closed."""

    def __init__(self, pieces, header=HEADER):
        self.pieces, self.header = pieces, header
        self.requests = []
        self.seen = threading.Semaphore(0)
        self.sent = threading.Event()
        self._over = threading.Event()
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}/stream"
        self._threads = [threading.Thread(target=self._serve)]

    def __enter__(self):
        self._threads[0].start()
        return self

    def __exit__(self, *_):
        self._over.set()
        for thread in self._threads:
            thread.join()
        self._socket.close()

    def _serve(self):
        while not self._over.is_set():
            try:
                client = self._socket.accept()[0]
            except TimeoutError:
                continue
            self._threads.append(threading.Thread(target=self._answer, args=(client,)))
            self._threads[-1].start()

    def _answer(self, client):
        with client, contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it has heard enough
            self.requests.append(client.recv(65536))
            client.sendall(self.header)
            for piece in self.pieces:
                if piece is None:  # hang up
                    return
                if piece == SEEN:
                    self.seen.acquire(timeout=20)
                elif isinstance(piece, float):
                    self._over.wait(piece)
                else:
                    client.sendall(piece)
            self.sent.set()
            self._over.wait(5)


class Capture:
    """Lacks the controls that are not in `properties`; clips those in `limits`."""

    def __init__(self, pictures=(), limits=None, **properties):
        self.pictures = list(pictures)
        self.limits = limits or {}
        self.released = 0
        self.properties = {
            cv2.CAP_PROP_FRAME_WIDTH: 320.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 240.0,
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV")),
            cv2.CAP_PROP_CONVERT_RGB: 1.0,
            cv2.CAP_PROP_POS_MSEC: 0.0,
            **{getattr(cv2, f"CAP_PROP_{name.upper()}"): value for name, value in properties.items()},
        }

    def isOpened(self):
        return True

    def get(self, which):
        return self.properties.get(which, -1.0)

    def set(self, which, value):
        if which not in self.properties:
            return False
        low, high = self.limits.get(which, (-np.inf, np.inf))
        self.properties[which] = min(max(value, low), high)
        return True

    def grab(self):
        return bool(self.pictures)

    def retrieve(self):
        picture = self.pictures.pop(0)
        if self.properties[cv2.CAP_PROP_CONVERT_RGB] == 0 and picture is not None:
            return True, np.frombuffer(picture, np.uint8)[None]
        return picture is not None, picture

    def release(self):
        self.released += 1


def large_jpeg(color=(200, 30, 10)):
    return jpeg((960, 1280), color)


START_NS = 1_700_000_000_000_000_000
FACTS = RecordingFacts("a camera", "S1", {"gain": 3.0}, 50.0, "abc")


def frames(count=6, shape=(48, 64), encoded=False, rate_hz=50.0):
    """Frames of noise (of one color where encoded), unevenly spaced, with one index left out."""
    rng = np.random.default_rng(0)
    made = []
    for k in range(count):
        index = k + (k > 2)
        time_s = 1000.0 + index / rate_hz + (0.003 if k == 1 else 0)
        content = jpeg(shape, (200, 10 * k, 5)) if encoded else None
        image = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
        made.append(Frame(image, time_s, START_NS + round(index / rate_hz * 1e9), index, content))
    return made


def recorded(path, given, facts=None, attached=None):
    """The path, after the frames were written to a recording there."""
    recording = McapRecording(path, facts or FACTS, attached)
    for frame in given:
        recording.write(frame)
    recording.close()
    return path


def video_file(path, images, codec="MJPG", rate_hz=25.0):
    """The path, after RGB images were written there as a video; FFV1 is without loss."""
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, (width, height))
    if not writer.isOpened():
        pytest.skip(f"this build of OpenCV cannot write {codec}")
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return path


def camera(count=6, **how):
    """A function that opens a source of those frames, at their pace."""
    return lambda: Playback(frames(count, **how), FACTS, paced=True)


class ImageSource(Closing):
    """Frames of the images given, again and again or once; `fails` is raised after the last."""

    serial = None

    def __init__(self, images, *, rate_hz=100.0, live=True, count=None, fails=None):
        self.images, self.rate_hz, self.live = images, rate_hz, live
        self.count, self.fails = count, fails
        self.name, self.settings = "images", {}
        self.closed = False

    def __iter__(self):
        index = 0
        while not self.closed and (self.count is None or index < self.count):
            if self.live:
                time.sleep(1 / self.rate_hz)
            image = self.images[index % len(self.images)]
            yield Frame(image, time.monotonic() if self.live else index / self.rate_hz, index, index)
            index += 1
        if self.fails is not None:
            raise self.fails

    def close(self):
        self.closed = True


def plug_in(root, number, product, usb_id=None, serial=None, socket="1-2", nodes=2):
    """Add a camera with its metadata node; its nodes are videoN and those after it."""
    classes, by_path = root / "sys/class/video4linux", root / "dev/v4l/by-path"
    for folder in (classes, by_path):
        folder.mkdir(parents=True, exist_ok=True)
    device = root / "sys/devices/pci0000:00/0000:00:14.0/usb1" / socket
    interface = device / f"{socket}:1.0"
    interface.mkdir(parents=True)
    if usb_id is not None:
        vendor, model = usb_id.split(":")
        told = {"idVendor": vendor, "idProduct": model, "product": product, "serial": serial}
        for name, text in told.items():
            if text is not None:
                (device / name).write_text(text + "\n")
    for index in range(nodes):
        node = interface / "video4linux" / f"video{number + index}"
        node.mkdir(parents=True)
        (node / "name").write_text(f"{product}: {product}"[:31] + "\n")
        (node / "index").write_text(f"{index}\n")
        (node / "device").symlink_to("../..")
        (classes / node.name).symlink_to(node)
        (root / "dev" / node.name).write_text("")
        link = by_path / f"pci-0000:00:14.0-usb-0:{socket[2:]}:1.0-video-index{index}"
        link.symlink_to(f"../../{node.name}")
    return device


MINI, DIGIT = "0c45:636d", "2833:0209"


@contextmanager
def small_disk(folder, kilobytes):
    """A file system of so many kB, mounted at a new folder; the test is skipped where none can be mounted."""
    folder.mkdir()
    size = f"size={kilobytes}k"
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"cannot mount a small file system here: {mounted.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


PLAIN = SimulatedSensor(
    (Led((-9, 2, 8), (9000, 500, 0)), Led((5, 9, 8), (0, 9000, 8000))), shape=(60, 80), mm_per_px=0.1
)
SMALL = replace(LAYOUTS["three-edges"], shape=(48, 64), mm_per_px=0.3)
DRAGGED = SimulatedSensor(
    (Led((-6, 2, 7), (4000, 500, 0)), Led((5, 5, 7), (0, 5000, 900))),
    shape=(60, 80),
    mm_per_px=0.1,
    gel=Gel(thickness_mm=2.0, bulge=0.6, friction=0.5),
    coating=Coating(marker_pitch_mm=1.0, marker_radius_mm=0.2),
)
LENGTH = 0.5  # mm over which the gel relaxes
AXIS = np.linspace(-4, 4, 161)  # mm, to look at faces on
X, Y = AXIS[None, :], AXIS[:, None]


def grid(half_mm, pitch):
    """Coordinates (1, n) and (n, 1) of a square grid about 0, mm."""
    n = 2 * round(half_mm / pitch) + 1
    axis = (np.arange(n) - n // 2) * pitch
    return axis[None, :], axis[:, None]


def box(width, height, depth):
    """Vertices (8, 3) and triangles (12, 3) of a closed box."""
    corners = np.array([(x, y, z) for x in (0, width) for y in (0, height) for z in (0, depth)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
