"""A real browser with the page; an error in the page fails the test."""

import os
import re
import shutil

import cv2
import numpy as np
import pytest

from live_waiting import HANGS_S, until

PLACES = [os.environ.get("GELFORM_CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome"]
CHROMIUM = next((found for name in PLACES if name and (found := shutil.which(name))), None)
# What a machine without a graphics processor does: WebGL by SwiftShader, the page put together by the processor.
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run"]


@pytest.fixture(scope="package")
def browser(request, tmp_path_factory):
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt install chromium, or set GELFORM_CHROMIUM to one")
    context = request.getfixturevalue("playwright").chromium.launch_persistent_context(
        str(tmp_path_factory.mktemp("profile")),
        executable_path=CHROMIUM,
        headless=True,
        args=FLAGS,
        viewport={"width": 1100, "height": 900},
    )
    yield context
    context.close()


@pytest.fixture
def visit(browser, serving):
    """Opens the page of a server, this test's by default; `before` is a script that runs in it first."""
    opened, troubles, hosts, servers = [], [], set(), set()

    def go(url=None, before=""):
        url = url or serving().url
        servers.add(re.sub(r"^\w+://([^/]*).*", r"\1", url))
        page = browser.new_page()
        page.set_default_timeout(1e3 * HANGS_S)
        opened.append(page)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("console", lambda said: troubles.append(said.text) if is_trouble(said) else None)
        page.on("request", lambda request: hosts.add(re.sub(r"^\w+://([^/]*).*", r"\1", request.url)))
        if before:
            page.add_init_script(before)
        page.goto(url)
        until(lambda: page.evaluate("Boolean(window.gelform?.facts)"))
        return page

    yield go
    for page in opened:
        page.close()
    assert troubles == []
    assert hosts <= servers


def is_trouble(said):
    """An error of the page's own: that a socket was refused while the server was away is the browser's to say."""
    return said.type == "error" and "WebSocket connection" not in said.text


@pytest.fixture
def page(visit, station):
    """The page, with the ball pressed and held."""
    station.source.press_at(120, 60, 0.5, held_s=600)
    opened = visit()
    until(lambda: opened.evaluate("window.gelform?.frame?.header.peak > 0.4"))
    return opened


@pytest.fixture
def still(page, station):
    """The picture of the page held: page and server show the same frame, whose result it is."""
    page.click("#pause")
    until(lambda: station.paused)
    until(lambda: page.evaluate("gelform.frame.header.serial") == station.newest.serial)
    until(lambda: page.evaluate("gelform.panes.every((one) => one.frame === gelform.frame && one.said)"))
    return station.newest.result


@pytest.fixture
def picture():
    """The pixels (H, W, 3) of an element as the screen has them."""

    def of(page, place):
        png = page.locator(place).screenshot()
        return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)

    return of


@pytest.fixture
def is_drawn(picture):
    """Whether the surface on a canvas is drawn: there are many colors."""
    return lambda page, at="#surface": len(np.unique(picture(page, at).reshape(-1, 3) // 16, axis=0)) > 20
