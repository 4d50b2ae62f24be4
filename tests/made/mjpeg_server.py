"""A small HTTP server that sends given bytes, complete or torn."""

import contextlib
import socket
import threading

import cv2
import numpy as np


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
