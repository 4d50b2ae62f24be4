"""A part of five frames, the third with an error, written in any form."""

import pytest

import gelform
from gelform.batch import BatchSettings, FilmRef
from gelform.batch.inputs import Part
from gelform.batch.outputs.files import PartTarget
from gelform.batch.outputs.writers import WRITERS
from made.small_gel import MM_PER_PX, SHAPE

COUNT = 5


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
        images = tuple(map(str, range(COUNT))) if counted else ()
        film = FilmRef(sequence, tmp_path, images, count=len(images), rate_hz=30)
        part = Part(0, film, count=len(images), names=images)
        facts = {"mm_per_px": MM_PER_PX, "calibration_digest": "abc"}
        settings = BatchSettings(form, **{"part_frames": COUNT, **settings})
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
