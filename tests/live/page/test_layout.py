"""The layout on a desktop and on a phone: legends, messages, reachable buttons; outdated figures are dimmed."""

import threading

import pytest

from gelform.errors import SourceLostError
from live_waiting import until

pytestmark = pytest.mark.slow

DESK, PHONE = {"width": 1400, "height": 900}, {"width": 390, "height": 844}


@pytest.fixture(params=[DESK, PHONE], ids=["desk", "phone"])
def sized(page, request):
    """The page at a size, which it has been laid out for."""
    page.set_viewport_size(request.param)
    until(lambda: page.evaluate("document.documentElement.clientWidth") == request.param["width"])
    until(
        lambda: (
            abs(box(page, "#panes")["width"] - page.evaluate("gelform.panes[0].node.parentNode.clientWidth"))
            < 1
        )
    )
    yield page
    page.set_viewport_size({"width": 1100, "height": 900})


def box(page, place):
    return page.locator(place).first.bounding_box()


def is_inside(inner, outer):
    return all(
        outer[at] - 0.5 <= inner[at] and inner[at] + inner[size] <= outer[at] + outer[size] + 0.5
        for at, size in (("x", "width"), ("y", "height"))
    )


def test_the_legend_of_why_pixels_are_not_trusted_stays_in_its_pane(sized):
    sized.select_option(".pane select >> nth=0", "causes")
    swatches = sized.locator(".pane >> nth=0 >> .legend .named")
    until(lambda: swatches.count() > 5)
    legend = box(sized, ".pane >> nth=0 >> .legend")
    assert is_inside(legend, box(sized, ".pane"))
    boxes = [swatches.nth(k).bounding_box() for k in range(swatches.count())]
    assert all(is_inside(one, legend) for one in boxes)
    places = {(round(one["x"]), round(one["y"])) for one in boxes}
    assert len(places) == len(boxes), "none lies on another"


NEEDED = "#theme, #help, .tabs button, #status, main button, main select, main input, main canvas"


def test_messages_cover_nothing_have_a_cross_and_go(sized, hub):
    hub.notice("The disk is almost full. " * 5, "error")
    hub.notice("Zero set: depth is relative to the last frames.")
    until(lambda: sized.locator(".toast").count() == 2)
    toasts = [sized.locator(".toast").nth(k).bounding_box() for k in range(2)]
    screen = {"x": 0, "y": 0, **sized.viewport_size}
    assert all(is_inside(one, screen) for one in toasts)
    script = f"""() => [...document.querySelectorAll({NEEDED!r})].filter((one) => one.checkVisibility())
        .map((one) => one.getBoundingClientRect()).map(({{ x, y, width, height }}) => ({{ x, y, width, height }}))"""
    for one in sized.evaluate(script):
        for toast in toasts:
            apart = (
                one["x"] >= toast["x"] + toast["width"]
                or toast["x"] >= one["x"] + one["width"]
                or one["y"] >= toast["y"] + toast["height"]
                or toast["y"] >= one["y"] + one["height"]
            )
            assert apart, (one, toast)
    sized.get_by_role("button", name="Dismiss").first.focus()
    sized.keyboard.press("Enter")
    until(lambda: sized.locator(".toast").count() == 1)
    until(lambda: sized.locator(".toast").count() == 0, 25)  # by itself


def test_the_background_is_within_reach(sized):
    for button in ("#background", "#zero"):
        found = box(sized, button)
        assert found["height"] >= 30
        assert found["y"] + found["height"] <= sized.viewport_size["height"], "without scrolling"


def test_figures_are_dimmed_while_there_are_no_new_ones(page, hub):
    lost, source = threading.Event(), hub.stations[0].source
    seen = source.image_at
    back = threading.Event()

    def image_at(index):
        if lost.is_set():
            back.wait(60)
            raise SourceLostError("The camera was unplugged.")
        return seen(index)

    source.image_at = image_at
    opacity = "getComputedStyle(document.querySelector('#number-peak .value')).opacity"
    until(lambda: page.evaluate(opacity) == "1")
    lost.set()
    until(lambda: page.inner_text("#status").startswith("reconnecting"))
    until(lambda: float(page.evaluate(opacity)) < 0.5)
    for place in (".pane .map", "#surface"):
        script = opacity.replace("#number-peak .value", place)
        until(lambda script=script: float(page.evaluate(script)) < 0.5)
    back.set()  # the next source is another one: whole again
    until(lambda: page.inner_text("#status").startswith("live"))
    until(lambda: page.evaluate(opacity) == "1")
    page.evaluate("gelform.connection.socket.onclose = null; gelform.connection.lost('')")
    until(lambda: float(page.evaluate(opacity)) < 0.5)  # the server does not answer
