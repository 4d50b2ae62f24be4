"""What commands refuse: one line that says what is wrong, or wrong usage; and every file stays as it was."""

import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration_file import load_calibration
from gelform.exchange.plots import save_picture
from made.files import web_file

MISTAKES = {  # by the beginning of a command: its other arguments, and words of the error
    "batch frames -o out": {
        "--background rest.png": "take a starter",
        "-c no_scale.npz": "has no scale",
        "-c cal.npz --background rest.png --background-frames 2": "got both",
    },
    "calibrate presses -o new.npz": {
        "--mm-per-px 0.00634": "presses: Expected a gel between 3 and 150 mm wide, got 160 px of 0.00634 mm: 1.01 mm.",
        "--report reported": "reported/circles.csv is already there",
    },
    "calibrate": {
        "no_toml -o new.npz": "--mm-per-px",
        "no_toml -o new.npz --sensor mini": "gelsight-mini, digit",
        "bare -o new.npz --mm-per-px 0.1268": "--background",
        "missing -o new.npz": "Expected a folder",
        "tiny -o new.npz": "1.01 mm",
        "presses -o cal.npz": "cal.npz is already there",
    },
    "compare": {"image.png -c cal.npz -c none.npz": "No file"},
    "crosstalk": {"presses green.png red.png blue.png": "brightest in red"},
    "design": {"bad.toml": "Did you mean 'noise_sd'", "none.toml": "No file"},
    "evaluate": {
        "presses -c none.npz": "No file",
        "presses -c cal.npz --mm-per-px 0.00634": "1.01 mm",
        "gray -c cal.npz --ball-diameter-mm 6 --mm-per-px 0.1": "Expected images of 120x160 px (height x width), got 60x80",
    },
    "explain": {
        "gray/other.png -c cal.npz": "other.png, for the calibration of small: Expected image of 120x160 px"
    },
    "export": {"cal.npz --to ply": "Expected a result to write for ply"},
    "import net.bin --background rest.png": {
        "--from gsrobotics -o new.npz": "zeros",
        "--from gs_sdk -o cal.npz": "already there",
    },
    "import": {"none.pth --from gs_sdk --background rest.png -o new.npz": "No file"},
    "info": {"missing": "No file or folder", "cut.npz": "damaged"},
    "lens presses --image red.png": {
        "--grid 9x6 --pitch-mm 1": "found none",
        "--grid 1x6 --pitch-mm 1": "--grid: Expected kind",
    },
    "live --folder frames": {
        "-c none.npz": "none.npz",
        "seq/": "No file or folder seq/. Check the path.",
        "simulated:three-edge": "three-edges",
        "--host 203.0.113.9": "address of this machine",
        "--sink rviz --rate 5": "sinks among rerun, foxglove, got rviz",
        "a b c -c x.npz -c y.npz": "one for each of the 3",
    },
    "record": {"http://127.0.0.1:9/x -o new": "Nothing answers"},
    "reconstruct -c cal.npz -o out": {
        "none.png": "No file",
        "text.png": "no image that can be read",
        "gray/other.png": "other.png, for the calibration of small: Expected image of 120x160 px",
        "noise.png": "noise.png: The background is not of this image",
        "image.png image.png": "given twice",
    },
    "reconstruct image.png": {
        "-c none.npz -o out": "No file",
        "-c image.png -o out": "Expected a gelform calibration, got the picture",
        "-c cal.npz -o image": "got the file",
        "-c cal.npz -o . --format png --overwrite": "replace an input",
        "-c cal.npz -o full": "already there",
        "--background rest.png -o out": "take a starter",
    },
    "scale presses": {
        "--points 1,1,2,2,5": "--points: Expected two points at least",
        "--points 20,10,100,70,-12": "--points: Expected distance_mm > 0",
        "--points 20,10,100,70,12 --points 20,10,100,70,6": "agree",
        "--stage none.png,nor.png,1": "No file",
    },
    "scale cal.npz": {"--points 20,10,100,70,12": "sensor.toml"},
    "simulate -o out": {
        "--height-map-mm-per-px 0.1 --height-map text.npy": "damaged",
        "--height-map-mm-per-px 0.1 --height-map many.npz": "archive",
        "--height-map-mm-per-px 0.1 --height-map nan.npy": "NaN",
        "--height-map-mm-per-px 0.1 --height-map none.npy": "No file",
        "--sensor bad.toml": "Did you mean 'noise_sd'",
    },
    "simulate": {"-o full --count 1": "holds something"},
    "starter": {
        "gelsight-mini --background rest.png -o new.npz": "GelSight Mini",
        "simulated-three-edges --background rest.png -o cal.npz": "already there",
    },
    "track": {
        "frames -c cal.npz -o text.png": "is already there",
        "missing.mcap -c cal.npz -o new.csv": "No recording",
    },
    "verify": {"missing": "Expected the output folder of gelform batch"},
}
WRONG_USAGE = {
    "": {"nonsense": "No such command", "reconstruct --nonsense": "No such option", "calibrate": "Missing"},
    "batch frames -c cal.npz -o out": {
        "--shard 3/2": "expected i/N",
        "--shard half": "expected i/N",
        "--format exr": "Expected a format among npz, png",
        "--keep all,depth": "Expected maps to keep",
    },
    "calibrate presses -o new.npz": {
        "--model magic": "polynomial",
        "--report report.html": "expected a folder, got the name of a file: report.html",
        "--crop 1,2,3": "LEFT,TOP,WIDTH,HEIGHT",
        "--background rest.png --background rest.png": "'--background': expected once, got 2 times.",
        "--mm-per-px 15.8": "up to 1 mm, got 15.8. If these are pixels per mm, give 1/15.8 = 0.06329.",
        "--mm-per-px px": "'--mm-per-px': expected a number > 0, got 'px'",
        "--mm-per-px 1e-6": "at least 0.0001 mm, got 1e-06. Is it in mm?",
        "--ball-diameter-mm 300": "'--ball-diameter-mm': Expected ball_diameter_mm up to 200 mm, got 300.",
        "--ball-diameter-mm 6,35": "got '6,35'. Write it with a decimal point: 6.35.",
    },
    "batch frames -c cal.npz": {"-o out.h5": "expected a folder, got the name of a file: out.h5"},
    "compare": {
        "image.png -c cal.npz": "expected two, got 1",
        "image.png -c cal.npz -c cal.npz -o new.png": "expected a folder, got the name of a file: new.png",
    },
    "evaluate presses -c cal.npz": {
        "--mm-per-px 15.8": "up to 1 mm",
        "--ball-diameter-mm 300": "up to 200 mm",
    },
    "force calibrate": {"a -c b -c d": "expected once, got 2 times"},
    "import net.bin -o new.npz": {
        "--from gs_sdk": "--background",
        "--from x --background rest.png": "gs_sdk, gsrobotics",
    },
    "info": {"": "--system", "--system presses": "--system"},
    "lens presses": {
        "": "Missing option",
        "--image red.png": "Missing option",
        "--grid 9x6": "Missing option",
        "--image red.png --grid nine --pitch-mm 1": "COLUMNSxROWS",
        "--image red.png --grid 9x6 --pitch-mm 0": "expected a number > 0",
    },
    "live": {"--sensor gelslim": "expected digit, gelsight-mini or simulated-three-edges, got 'gelslim'"},
    "record simulated -o new.mcap": {
        "--presses": "diameter of the ball",
        "--set exposure": "NAME=VALUE",
        "--set exposure=x": "a number",
        "--set exposur=3": "exposur",
        "--sensor digit": "--presses only",
    },
    "explain image.png": {"--sensor simulated-three-edges -c cal.npz": "-c names the calibration already"},
    "reconstruct image.png -c cal.npz -o out": {"--format npz,obj": "npz, png"},
    "reconstruct image.png -o out": {
        "--mm-per-px 0.05": "name it with --sensor",
        "--sensor simulated-three-edges": "needed with --sensor: an image of the gel at rest",
        "--sensor simulated-three-edges --background all.csv": "needed with --sensor: an image of the gel at rest",
        "--sensor gelslim --background rest.png": "expected digit, gelsight-mini or simulated-three-edges, got",
    },
    "ros -c cal.npz": {
        "--topics depth": "--topics",
        "--name 'Left Finger'": "--name",
        "--domain 233": "--domain",
    },
    "bag frames -c cal.npz": {
        "-o new.mcap": "expected a folder, got the name of a file: new.mcap. Leave out .mcap"
    },
    "bag frames -c cal.npz -o new": {"--topics depth": "--topics", "--name 'Left Finger'": "--name"},
    "scale presses": {
        "": "--points, --stage or both",
        "--points 1,2,3": "X1,Y1,X2,Y2,MM",
        "--stage left.png,2": "A,B,MM",
    },
    "simulate -o out": {
        "--count 0": "--count",
        "--ball-diameter-mm 0": "--ball-diameter-mm",
        "--ball-diameter-mm 300": "from 0.254 to 18.5 mm, got 300",
        "--sensor x": "three-edges",
        "--sensor digi": "Did you mean 'digit'",
        "--height-map nan.npy": "--height-map-mm-per-px",
        "--height-map ones.npy --height-map-mm-per-px 0.1 --depth-mm 3": "thickness, 3 mm",
        "--as video,avi": "--as",
        "--as video --depth-mm 9": "--depth-mm",
        "--like polycalib.npz": "--mm-per-px",
        "--background rest.png": "--background",
    },
    "starter": {
        "gelslim --background rest.png -o new.npz": "expected digit, gelsight-mini or",
        "simulated-three-edges -o new.npz": "--background",
    },
    "track frames -c cal.npz -o new.csv": {
        "--prior 0.1,-2": "--prior",
        "--prior 0.1": "--prior",
        "--surface a.obj": "expected .npz, .ply, ",
    },
}
ROWS = [
    (f"{command} {more}".strip(), text, status)
    for status, rows in ((1, MISTAKES), (2, WRONG_USAGE))
    for command, refused in rows.items()
    for more, text in refused.items()
]


@pytest.fixture(scope="session")
def place(press_folder, calibration_file, leds, tmp_path_factory):
    """A folder with all that the commands name."""
    folder, rng = tmp_path_factory.mktemp("place"), np.random.default_rng(0)
    for name, gone in (("presses", "truth"), ("no_toml", "sensor.toml"), ("bare", ".*"), ("tiny", "truth")):
        shutil.copytree(press_folder, folder / name, ignore=shutil.ignore_patterns(gone, "truth"))
    for path in (folder / "bare" / "sensor.toml", folder / "bare" / "background.png"):
        path.unlink()
    settings = folder / "tiny" / "sensor.toml"
    settings.write_text(settings.read_text().replace("0.1268", "0.00634"))
    shutil.copy(calibration_file, folder / "cal.npz")
    (folder / "cut.npz").write_bytes(calibration_file.read_bytes()[:1000])
    replace(load_calibration(calibration_file), mm_per_px=None).save(folder / "no_scale.npz")
    shutil.copy(press_folder / "background.png", folder / "rest.png")
    for name in ("image.png", "frames/0.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(press_folder / "images" / "0000.png", folder / name)
    (folder / "gray").mkdir()
    for name in ("gray/background.png", "gray/other.png"):
        save_picture(folder / name, np.full((60, 80, 3), 90, np.uint8))
    save_picture(folder / "noise.png", rng.integers(0, 256, (120, 160, 3), dtype=np.uint8))
    for path in leds:
        shutil.copy(path, folder)
    for name in ("text.png", "image", "text.npy", "full/image.npz", "reported/circles.csv"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("hello")
    np.save(folder / "nan.npy", np.full((4, 4), np.nan))
    np.save(folder / "ones.npy", np.ones((20, 20)))
    np.savez(folder / "many.npz", a=np.zeros(3))
    table = np.zeros((90, 90, 6))
    np.savez(folder / "polycalib.npz", bins=90, grad_r=table, grad_g=table, grad_b=table)
    (folder / "bad.toml").write_text(
        'base = "ring-120"\nshape = [120, 160]\nmm_per_px = 0.1268\nnoise_ds = 3\n'
    )
    web_file(folder / "net.bin")
    return folder


def state(folder):
    return {
        path: (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*") if path.is_file()
    }


@pytest.mark.parametrize(("command", "text", "status"), ROWS, ids=[row[0] for row in ROWS])
def test_a_refusal_says_why_and_changes_nothing(fails, place, monkeypatch, command, text, status):
    monkeypatch.chdir(place)
    before = state(place)
    assert text in fails(*shlex.split(command), status=status)
    assert state(place) == before
