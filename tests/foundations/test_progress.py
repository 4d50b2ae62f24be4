"""Long work reports to a callable (done, total, what); by default to none."""

import inspect
from importlib import import_module

import gelform
from gelform.foundations.progress import Progress, no_progress


def test_nothing_is_reported_by_default(capsys):
    assert no_progress(1, 2, "working") is None
    assert capsys.readouterr() == ("", "")


def test_every_public_progress_is_that_one():
    functions = [value for name in gelform.__all__ if inspect.isfunction(value := getattr(gelform, name))]
    reporting = [one for one in functions if "progress" in inspect.signature(one).parameters]
    assert reporting
    for function in reporting:
        parameter = inspect.signature(function).parameters["progress"]
        assert parameter.annotation in (Progress, "Progress"), function
        assert parameter.default is no_progress, function
        assert import_module(function.__module__).Progress is Progress, function
