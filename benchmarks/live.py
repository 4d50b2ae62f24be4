"""The live page: first picture, rates and age in a browser, four clients of which one stalls, the guide, the page itself.

    python benchmarks/live.py            # about four minutes on a quiet machine
    python benchmarks/live.py --quick    # about one and a half: shorter spans, six presses; writes nothing
    python benchmarks/live.py --rates    # one: only the rates in the browser; writes nothing
    python benchmarks/live.py --starter  # one: time to depth for an uncalibrated sensor; writes only that part
    python benchmarks/live.py --clicks   # one: pictures of a page while others click on Background; writes only that part
    python benchmarks/live.py --pictures docs/images/live    # two: takes the pictures of docs/live.md instead
    python benchmarks/live.py --moving docs/images/live      # two: takes the README's moving picture instead
    python benchmarks/live.py --calibration                  # makes the shipped calibration of the simulated sensor

`gelform live` runs as for a user; its clients are a headless Chromium and websockets. Chromium gets the flags that it
needs to start here, and to compute WebGL2 without a graphics processor (SwiftShader). It then also composes the page
on the processor, as on any machine without a graphics processor. A figure that cannot be measured is left out, with a
message. Writes results/live.json with the machine's load, and Chromium's version and flags.

axe-core is found by GELFORM_AXE or in node_modules (npm install axe-core).
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from pathlib import Path
from typing import Any

from gelform.live.web.app import page_files
from live.calibration import make_calibration
from live.clicks import while_clicked
from live.guided import WANTED, guided
from live.moving import take_moving
from live.pictures import take_pictures
from live.server import CHROMIUM, COMPUTED_S, FLAGS, Live, running
from live.starter import to_depth
from live.viewer import Viewer
from report import recorded, table, write, write_part

AXE = Path(os.environ.get("GELFORM_AXE", "node_modules/axe-core/axe.min.js"))
STARTS, SETTLE_S = 3, 5.0
PARTS = ("starter", "clicks")  # parts of results/live.json with a switch of their own


def first_pictures() -> list[float]:
    """Seconds from the start of the process to the first depth at a client, for several consecutive starts."""
    found = []
    for _ in range(STARTS):
        with running() as (live, _):
            viewer = Viewer(live)
            viewer.start()
            while viewer.first_s is None:
                time.sleep(0.01)
            viewer.stop.set()
            viewer.join(25)
        found.append(viewer.first_s)
    return found


def clients(live: Live, seconds: float) -> dict[str, Any]:
    """One client alone; then with three more: a normal one, one at 2 Hz, one that stalls. Rates, ages and memory."""
    alone = Viewer(live)
    alone.start()
    time.sleep(SETTLE_S)
    before = alone.pictures
    time.sleep(seconds / 2)
    alone_hz = (alone.pictures - before) / (seconds / 2)
    others = [Viewer(live), Viewer(live, most_hz=2), Viewer(live, stalled=True)]
    for one in others:
        one.start()
    time.sleep(SETTLE_S)
    measured = {"first": alone, "second": others[0], "two_hz": others[1]}
    counts, before = {name: one.pictures for name, one in measured.items()}, len(alone.results)
    memory = [live.resident_mb()]
    for _ in range(4):
        time.sleep(seconds / 4)
        memory.append(live.resident_mb())
    station = alone.state["stations"][0]
    found = {
        "alone_hz": alone_hz,
        "shown_hz": {name: (one.pictures - counts[name]) / seconds for name, one in measured.items()},
        "results_told_hz": (len(alone.results) - before) / seconds,
        "reconstructed_hz": station["rate_hz"],
        "reconstruction_ms": station["took_ms"],
        "age_at_client_ms": statistics.median(alone.ages_ms[-200:]),
        "memory_mb": memory,
    }
    for one in (alone, *others):
        one.stop.set()
    for one in (alone, *others):
        one.join(25)
    return found


def in_browser(page: Any, seconds: float) -> dict[str, Any]:
    """Pictures per second, and time from capture to screen."""
    page.wait_for_timeout(1e3 * COMPUTED_S)
    serial, times, ages = "gelform.frame.header.serial", [], []
    surfaces = page.evaluate("gelform.look.surfaces")
    first, began = page.evaluate(serial), time.monotonic()
    while time.monotonic() - began < seconds:
        page.evaluate("gelform.look.ages = []")
        page.wait_for_timeout(1000)
        ages += page.evaluate("gelform.look.ages")
        times.append(page.evaluate("gelform.look.drawnHz"))
    took = time.monotonic() - began
    return {
        "reconstructed_hz": (page.evaluate(serial) - first) / took,
        "drawn_hz": len(ages) / took,
        "drawn_hz_median": statistics.median(times),
        "surface_hz": (page.evaluate("gelform.look.surfaces") - surfaces) / took,
        "capture_to_screen_ms": statistics.median(ages),
        "capture_to_screen_p95_ms": sorted(ages)[int(0.95 * len(ages))],
        "renderer": page.evaluate("gelform.look.renderer"),
    }


def accessibility(page: Any) -> dict[str, Any]:
    """Serious and critical findings of axe-core, by theme and page."""
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = {"axe": page.evaluate("axe.version")}
    for _ in ("one theme", "the other"):
        theme = page.evaluate("document.documentElement.dataset.theme")
        for tab in ("live", "calibrate"):
            page.click(f"#tab-{tab}")
            page.wait_for_timeout(500)
            rows = page.evaluate("axe.run({ resultTypes: ['violations'] })")["violations"]
            found[f"{theme} {tab}"] = [row["id"] for row in rows if row["impact"] in ("serious", "critical")]
        page.click("#theme")
    page.click("#tab-live")
    return found


def browser(live: Live, folder: Path, seconds: float, presses: int) -> dict[str, Any]:
    """One headless Chromium: rates; with `presses` also accessibility, the guided calibration, requests to other hosts."""
    from playwright.sync_api import sync_playwright

    hosts = set()
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        page = chromium.new_page(viewport={"width": 1300, "height": 900})
        page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
        page.goto(live.url)
        found: dict[str, Any] = {
            "version": chromium.version,
            "flags": FLAGS,
            "shown": in_browser(page, seconds),
        }
        if not presses:
            return found
        if AXE.is_file():
            found["accessibility"] = accessibility(page)
        else:
            print(f"no axe-core in {AXE}: its figure is left out")
        found["guided"] = guided(page, folder, presses)
        found["other_hosts"] = sorted(hosts - {live.address})
        chromium.close()
    return found


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="shorter; results/live.json stays as it is")
    parser.add_argument("--rates", action="store_true", help="the rates in the browser alone")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="take the pictures of docs/live.md")
    parser.add_argument("--moving", type=Path, metavar="FOLDER", help="take the README's moving picture")
    parser.add_argument("--calibration", action="store_true", help="make the shipped calibration again")
    parser.add_argument(
        "--starter", action="store_true", help="to depth of a sensor that was never calibrated"
    )
    parser.add_argument("--clicks", action="store_true", help="pictures of a page while others click")
    asked = parser.parse_args()
    if asked.clicks:
        clicked = while_clicked()
        write_part("live", "clicks", clicked)
        print(json.dumps(clicked, indent=1))
        return
    if asked.starter:
        starter = to_depth()
        write_part("live", "starter", starter)
        print(json.dumps(starter, indent=1))
        return
    if asked.pictures or asked.moving or asked.calibration:
        if asked.pictures:
            take_pictures(asked.pictures)
        if asked.moving:
            take_moving(asked.moving)
        if asked.calibration:
            make_calibration()
        return
    seconds, presses = (6.0, 6) if asked.quick else (30.0, WANTED)
    if asked.rates:
        with running() as (live, folder):
            print(json.dumps(browser(live, folder, seconds, 0), indent=1))
        return
    figures: dict[str, Any] = {
        "page_kb": sum(map(len, page_files().values())) / 1e3,
        "load_before": os.getloadavg()[0],
        "seconds": seconds,
        "first_depth_s": first_pictures(),
    }
    with running() as (live, folder):
        if CHROMIUM is None:
            print("no Chromium: the browser's figures are left out")
        else:
            figures["browser"] = browser(live, folder, seconds, presses)
    with running() as (live, _):
        figures["clients"] = clients(live, seconds)
    if not asked.quick:
        write("live", {**figures, **{k: v for k, v in recorded("live").items() if k in PARTS}})
    print(json.dumps(figures, indent=1))
    print(table(["", "reach", "reached"], rows(figures)))


def rows(figures: dict[str, Any]) -> list[list[Any]]:
    """Each required figure with the measured one."""
    told, shown, memory = figures["clients"], figures["clients"]["shown_hz"], figures["clients"]["memory_mb"]
    listed = [
        ["first picture, warm, s", "2", statistics.median(figures["first_depth_s"][1:])],
        ["pictures a second of a client", "20", told["alone_hz"]],
        ["the same beside three others", "as many", shown["first"]],
        ["of the one at 2 Hz", "2", shown["two_hz"]],
        ["memory at the start and the end, MB", "equal", f"{memory[0]:.0f}, {memory[-1]:.0f}"],
        ["page, kB", "300", figures["page_kb"]],
    ]
    if "browser" not in figures:
        return listed
    found = figures["browser"]
    listed += [
        ["reconstructions a second", "60", found["shown"]["reconstructed_hz"]],
        ["pictures drawn a second", "20", found["shown"]["drawn_hz"]],
        ["of them with the surface", "", found["shown"]["surface_hz"]],
        ["capture to screen, median ms", "100", found["shown"]["capture_to_screen_ms"]],
        ["guided calibration, s", "120", found["guided"]["total_s"]],
        ["its held-out error over the offline one", "1.3", found["guided"]["held_out_ratio"]],
        ["its error on unseen presses over the offline one", "1.3", found["guided"]["unseen_ratio"]],
        ["requests to other hosts", "none", ", ".join(found["other_hosts"]) or "none"],
    ]
    if "accessibility" in found:
        serious = sum(len(ids) for key, ids in found["accessibility"].items() if key != "axe")
        listed.append(["serious findings of axe-core", "0", serious])
    return listed


if __name__ == "__main__":
    main()
