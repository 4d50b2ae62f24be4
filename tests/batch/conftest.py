"""A small data set: two folders of images of an exactly known gel; one folder also contains invalid files.

A part of five frames, the third with an error, written in any form.
"""

import numpy as np
import pytest

import gelform
from gelform.batch import BatchSettings, FilmRef
from gelform.batch.inputs import Part
from gelform.batch.outputs.files import PartTarget
from gelform.batch.outputs.writers import WRITERS
from made import files
from made.small_gel import MM_PER_PX, SHAPE, calibration, image_of, save
from made.sources import video_file

WRITTEN = 5  # frames of a part that is written


@pytest.fixture
def tree(tmp_path, images):
    """in/frame*.png and in/day2/frame*.png; the tenth comes after the second."""
    for folder in (tmp_path / "in", tmp_path / "in" / "day2"):
        folder.mkdir()
        for number, image in zip((1, 2, 10, 11), images):
            save(folder / f"frame{number}.png", image)
    return tmp_path / "in"


@pytest.fixture
def broken_tree(tree, images):
    """The same with a truncated image, one of another size, an empty one and a text among them."""
    whole = (tree / "frame1.png").read_bytes()
    (tree / "cut.png").write_bytes(whole[: len(whole) // 2])
    (tree / "empty.png").write_bytes(b"")
    (tree / "text.png").write_text("no picture at all\n")
    save(tree / "wide.png", np.hstack([images[0], images[0]]))
    return tree


@pytest.fixture(scope="session")
def cal():
    return calibration()


@pytest.fixture
def film(tmp_path, images):
    """A video of the touches, without loss."""
    return video_file(tmp_path / "press.avi", images, "FFV1")


@pytest.fixture
def visible():
    return files.visible


@pytest.fixture
def two_lights(tmp_path):
    """Two sequences of an untouched gel, the second under a brighter red light; their backgrounds lie among them."""
    for name, factor in (("a", 1), ("b", np.array([1.1, 1, 1]))):
        image = np.clip(image_of(None) * factor, 0, 255).astype(np.uint8)
        (tmp_path / "in" / name).mkdir(parents=True)
        for one in ("0.png", "rest.png"):
            save(tmp_path / "in" / name / one, image)
    return tmp_path / "in"


@pytest.fixture(scope="session")
def results(cal, images):
    """Of touches; the third could not be done."""
    reconstruct = gelform.Reconstructor(cal)
    done = [reconstruct.from_image(image) for image in (*images, images[0])]
    return [*done[:2], None, *done[3:]]


@pytest.fixture
def written(results, tmp_path):
    """Writes them; gives the writer and the rows."""

    def write(form, *, sequence="day/a", counted=True, interrupted=False, folder=tmp_path, **settings):
        images = tuple(map(str, range(WRITTEN))) if counted else ()
        film = FilmRef(sequence, tmp_path, images, count=len(images), rate_hz=30)
        part = Part(0, film, count=len(images), names=images)
        facts = {"mm_per_px": MM_PER_PX, "calibration_digest": "abc"}
        settings = BatchSettings(form, **{"part_frames": WRITTEN, **settings})
        target = PartTarget(folder, part, settings, SHAPE, facts)
        with WRITERS[form].writer(target) as writer:
            rows = [
                writer.add(str(k), k, None if result is None else writer.prepared(result))
                for k, result in enumerate(results)
            ]
            if interrupted:
                raise KeyboardInterrupt
        return writer, rows

    return write
