"""What to do with files that gelform does not read, by the ending of their names."""

from __future__ import annotations

import os
from pathlib import PurePath

_PICKLE = (
    "It is a pickle. Reading one can run code, so gelform does not. If you trust it, save its frames where it was made: "
    'numpy.save("frames.npy", frames).'
)
_ARCHIVE = "It is an archive. Unpack it, and give the folder."
_WEIGHTS = (
    "It may be the network of another package. Make a calibration of it: gelform import {name} --from gs_sdk --background "
    "rest.png -o cal.npz (or --from gsrobotics)."
)


def conversion_of_bag(name: str, stem: str) -> str:
    """The command that makes a bag that gelform reads."""
    return f"Convert it: rosbags-convert --src {name} --dst {stem}_mcap --dst-storage mcap (pip install rosbags)."


WAYS = {
    ".npz": "It is an archive of arrays. Save the frames alone: "
    'numpy.save("frames.npy", numpy.load("{name}")["NAME"]).',
    **dict.fromkeys((".pkl", ".pickle", ".p"), _PICKLE),
    **dict.fromkeys((".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar"), _ARCHIVE),
    **dict.fromkeys((".pth", ".pt"), _WEIGHTS),
    ".mat": "It may be the look-up table of another package. Make a calibration of it: gelform import {name} --from lut "
    "--background rest.png -o cal.npz.",
    ".tmd": "It is a height map of GelSight's scanner software: measured already, with nothing to reconstruct. "
    "gelform reads the sensor's images.",
    ".bag": "It is a bag of ROS 1. " + conversion_of_bag("{name}", "{stem}"),
    ".db3": "It is a part of a bag of sqlite3. " + conversion_of_bag("FOLDER", "{stem}"),
    **dict.fromkeys(
        (".dng", ".raw", ".cr2", ".nef", ".arw", ".heic"), "Save it as PNG, with 8 bits for each color."
    ),
}


def way_for(path: str | os.PathLike[str]) -> str:
    """A sentence with what to do with a file of a kind that is not read, after a space; empty for other kinds."""
    name = PurePath(path)
    way = WAYS.get(name.suffix.lower(), "")
    return way and " " + way.replace("{name}", name.name).replace("{stem}", name.stem)
