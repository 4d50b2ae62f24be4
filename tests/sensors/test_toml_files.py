"""TOML files: each fault is a sentence, of the caller's class."""

import pytest

from gelform.cli import main
from gelform.errors import DataError, SensorError
from gelform.sensors.toml_files import read_toml

FAULTS = {
    "nested": (b"a = " + b"[" * 20_000 + b"]" * 20_000, "holds tables inside tables beyond reason"),
    "dotted": (b"a" + b".a" * 20_000 + b" = 1", "holds tables inside tables beyond reason|is no TOML"),
    "latin": ("name = 'Pr\u00fcfling'".encode("latin-1"), "is no text in UTF-8: byte 10"),
    "torn": (b"name = ", "is no TOML file"),
}


@pytest.mark.parametrize("fault", ["nested", "latin", "torn"])
def test_a_fault_is_a_sentence(tmp_path, fault):
    path = tmp_path / "sensor.toml"
    path.write_bytes(FAULTS[fault][0])
    for error in (DataError, SensorError):
        with pytest.raises(error, match=FAULTS[fault][1]):
            read_toml(path, "settings", error)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    "command",
    [
        "design {}",
        "simulate --sensor {} -o out",
        "info {}/..",
        "live simulated:{}",
        "calibrate {}/.. -o a.npz",
    ],
)
def test_every_command_that_reads_one_says_it(tmp_path, capsys, monkeypatch, fault, command):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "sensor.toml"
    path.write_bytes(FAULTS[fault][0])
    with pytest.raises(SystemExit) as stopped:
        main(command.replace("{}/..", str(tmp_path)).replace("{}", str(path)).split(" "))
    assert stopped.value.code in (0, 1, 2), capsys.readouterr().err
    assert "bug" not in capsys.readouterr().err
