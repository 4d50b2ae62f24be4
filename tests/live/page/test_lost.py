"""The page without WebGL, with a graphics processor, and after the machine slept: the socket is dropped."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from live_waiting import until

pytestmark = pytest.mark.slow

NO_WEBGL = """
const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return /webgl/.test(kind) ? null : get.call(this, kind, ...more);
};
"""


def test_without_webgl_the_surface_is_a_shaded_relief(visit, hub, picture):
    hub.stations[0].source.press_at(120, 60, 0.5, held_s=600)
    page = visit(before=NO_WEBGL)
    until(lambda: page.evaluate("gelform.frame?.header.peak > 0.4"))
    assert "no WebGL2" in page.evaluate("gelform.look.renderer")
    until(lambda: len(np.unique(picture(page, "#surface").reshape(-1, 3) // 16, axis=0)) > 20)
    page.click("#reset-view")  # does nothing there, without an error


GRAPHICS = """
const get = WebGL2RenderingContext.prototype.getParameter, RENDERER = 0x9246;
WebGL2RenderingContext.prototype.getParameter = function (name) {
  return name === RENDERER ? "a graphics processor" : get.call(this, name);
};
"""


def test_with_a_graphics_processor_every_pixel_is_a_vertex_and_every_frame_is_drawn(visit, hub, picture):
    """The processor computes it here too, under another name."""
    hub.stations[0].source.press_at(120, 60, 0.5, held_s=600)
    page = visit(before=GRAPHICS)
    until(lambda: page.evaluate("gelform.frame?.header.peak > 0.4"))
    assert page.evaluate("gelform.look.renderer") == "WebGL2"
    assert page.evaluate("gelform.connection.ahead") == 2
    until(lambda: page.evaluate("gelform.surface.grid") == [176, 132])
    until(
        lambda: page.evaluate(
            "gelform.surface.canvas.width === Math.round(gelform.surface.canvas.clientWidth)"
        )
    )
    until(lambda: len(np.unique(picture(page, "#surface").reshape(-1, 3) // 16, axis=0)) > 20)


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs signals that stop a process")
def test_after_sleep_the_page_comes_back_by_itself(visit):
    """The server's process stands still as a sleeping machine's does: nothing is closed, nothing comes."""
    command = [sys.executable, "-m", "gelform", "live", "--quiet", "--rate", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            page = visit(server.stdout.readline().strip())
            until(lambda: page.evaluate("Boolean(gelform.frame)"))
            os.kill(server.pid, signal.SIGSTOP)
            until(lambda: not page.evaluate("gelform.connection.open"))
            until(lambda: "does not answer" in page.inner_text("#banner"))
            os.kill(server.pid, signal.SIGCONT)
            until(lambda: page.evaluate("gelform.connection.open"))
            serial = page.evaluate("gelform.frame.header.serial")
            until(lambda: page.evaluate("gelform.frame.header.serial") > serial)
            until(lambda: page.is_hidden("#banner"))
        finally:
            server.kill()
