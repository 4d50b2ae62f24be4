"""What to do with files of other programs, by their names."""

from gelform.foundations.foreign_files import WAYS, way_for


def test_other_kinds_have_no_way_and_names_stay_as_they_are():
    assert way_for("a.png") == way_for("folder") == ""
    assert "rosbags-convert --src {x} 1.bag --dst {x} 1_mcap" in way_for("day/{x} 1.bag")
    assert all(way_for(f"a{suffix}").startswith(" ") for suffix in WAYS)
