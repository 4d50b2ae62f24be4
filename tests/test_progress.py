"""Long work reports to a callable (done, total, what); by default to none."""

import inspect
from importlib import import_module

import pytest

import gelform
from gelform.progress import Progress, no_progress


def test_nothing_is_reported_by_default(capsys):
    assert no_progress(1, 2, "working") is None
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", sorted(gelform.__all__))
def test_every_public_progress_is_that_one(name):
    value = getattr(gelform, name)
    parameters = inspect.signature(value).parameters if inspect.isfunction(value) else {}
    if "progress" in parameters:
        assert parameters["progress"].annotation in (Progress, "Progress")
        assert parameters["progress"].default is no_progress
        assert import_module(value.__module__).Progress is Progress
