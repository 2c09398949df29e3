"""The choice of ratings by season and kind, their file, and what is refused."""

import math
from dataclasses import replace

import pytest

from dcgrid_env import Feeder, FeederError, load_feeder, make_scenario, read_feeder, scenario_hash
from dcgrid_env.grid import with_ratings
from dcgrid_env.grid.network import RatingTable


def rated(name, rows):
    feeder = load_feeder(name)
    table = RatingTable(*zip(*rows, strict=True))
    return type(feeder).from_network(replace(feeder.to_network(), rating=table))


ROWS = {
    "ieee33": [("branch 1-2", "winter", 400.0, 500.0), ("branch 3-2", "", math.nan, 350.0)],
    "ieee13-3ph": [("line 650632", "winter", 700.0, 800.5), ("transformer sub", "", math.nan, 7000.0)],
}


@pytest.mark.parametrize("name", ROWS)
def test_a_folder_keeps_the_ratings_to_the_bit(name, tmp_path):
    feeder = rated(name, ROWS[name])
    feeder.to_csv(tmp_path)
    assert repr(read_feeder(tmp_path).to_network().rating) == repr(feeder.to_network().rating)
    first = (tmp_path / "ratings.csv").read_text().splitlines()
    assert first[0] == "element,season,normal,emergency"
    assert first[2].startswith(f"{ROWS[name][1][0]},,,")


def test_a_branch_is_rated_by_either_direction_and_keeps_others_without():
    feeder = rated("ieee33", ROWS["ieee33"])
    assert isinstance(feeder, Feeder)
    chosen = with_ratings(feeder, "emergency", "winter")
    rating_a = chosen.feeder.rating_a
    assert rating_a is not None
    assert rating_a[:2].tolist() == [500.0, 350.0]
    assert math.isnan(rating_a[2])
    assert chosen.without == ("branch 2-3",)
    assert with_ratings(feeder).feeder is feeder


def test_ratings_change_the_hash_and_their_absence_does_not():
    scenario = make_scenario("ieee33")
    same = Feeder.from_network(scenario.feeder.to_network())
    other = scenario.replace(feeder=rated("ieee33", ROWS["ieee33"]))
    assert scenario_hash(scenario.replace(feeder=same)) == scenario_hash(scenario) != scenario_hash(other)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (("branch 1-99", "winter", 1.0, 1.0), "there is no such element; give 'branch FROM-TO'"),
        (("branch 1-2", "winter", -1.0, 1.0), "normal is -1.0; give a number > 0"),
        (("branch 1-2", "winter", 1.0, math.inf), "emergency is inf; give a number > 0"),
        (("branch 1-2", "", 1.0, 1.0), "normal is 1.0 without a season"),
        (("branch 1-2", "winter", math.nan, math.nan), "normal and emergency are empty"),
        (("branch 3-2", "", math.nan, 9.0), "season '' is there twice"),
    ],
)
def test_invalid_rows_are_refused_by_element_and_field(row, said):
    with pytest.raises(FeederError, match=said):
        rated("ieee33", [("branch 2-3", "", math.nan, 350.0), row])


@pytest.mark.parametrize(
    ("rating", "season", "said"),
    [
        ("normal", "autumn", "season is 'autumn'; choose winter"),
        ("rated", "", "rating is 'rated'; choose normal or emergency"),
    ],
)
def test_an_unknown_choice_is_refused(rating, season, said):
    with pytest.raises(FeederError, match=said):
        with_ratings(rated("ieee33", ROWS["ieee33"]), rating, season)
    with pytest.raises(FeederError, match="no emergency rating is known"):
        with_ratings(load_feeder("ieee33"), "emergency")
    with pytest.raises(FeederError, match="without seasons in ratings"):
        with_ratings(load_feeder("ieee33"), "normal", "winter")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("element,season,normal\n", "the column 'emergency' is missing"),
        ("element,season,normal,emergency\n,winter,1,2\n", "line 2: element is empty"),
        ("element,season,normal,emergency\nbranch 1-2,winter,x,2\n", "line 2: normal is 'x'; give a number"),
        ("element,season,normal,emergency\nbranch 1-2,winter,nan,2\n", "line 2: normal is 'nan'; give a finite number"),
        ("element,season,normal,emergency\nbranch 1-2,winter,1,2,3\n", "\\['3'\\] is beyond the last column"),
    ],
)
def test_an_invalid_file_is_refused_by_line(text, said, tmp_path):
    load_feeder("ieee33").to_csv(tmp_path)
    (tmp_path / "ratings.csv").write_text(text)
    with pytest.raises(FeederError, match=said):
        read_feeder(tmp_path)


def test_a_feeder_replaces_the_tables_of_another_in_its_folder(tmp_path):
    load_feeder("ieee13-3ph").to_csv(tmp_path)
    feeder = load_feeder("ieee33")
    (tmp_path / "ratings.csv").write_text("element,season,normal,emergency\nline 650632,,400,\n")
    (tmp_path / "notes.txt").write_text("not of a feeder")
    feeder.to_csv(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["branches.csv", "buses.csv", "feeder.toml", "notes.txt"]
    again = Feeder.from_csv(tmp_path)
    assert len(again.to_network().rating) == 0
    assert again.bus_ids == feeder.bus_ids
    assert (again.r_ohm == feeder.r_ohm).all()


def test_tables_without_a_feeder_are_kept_and_named(tmp_path):
    load_feeder("ieee13-3ph").to_csv(tmp_path)
    (tmp_path / "feeder.toml").unlink()
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    with pytest.raises(
        FeederError, match=r"has capacitors\.csv and no feeder\.toml, .*; give an empty folder, or delete"
    ):
        load_feeder("ieee33").to_csv(tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before
