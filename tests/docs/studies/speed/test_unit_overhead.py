"""What units of work cost: the simulation of many workers, and the command."""

import pytest

from docs.studies.commands import main
from docs.studies.speed.unit_overhead import Overhead, simulated_s, steps_of


def test_one_worker_does_one_after_the_other_and_many_are_held_up_by_the_driver():
    cost = Overhead("place", 2.0, 0.5, (0.0, 0.0), 1.0)
    assert simulated_s(cost, 10, 3.0, 1) == pytest.approx(2.0 + 10 * 4.0)
    assert simulated_s(cost, 10, 3.0, 2) == pytest.approx(2.0 + 5 * 4.0)
    assert simulated_s(cost, 1000, 3.0, 1000) == pytest.approx(1000 * 0.5 + 4.0)


@pytest.mark.slow
def test_steps_follow_the_time_asked_for():
    assert 0 < steps_of(0.001) < steps_of(1.0)


@pytest.mark.slow
def test_the_command(capsys):
    main(["unit-overhead", "--workers", "2", "--units", "2", "--seconds", "0.01", "--repeats", "1"])
    said = capsys.readouterr().out
    assert "this machine" in said
    assert "512 workers" in said


def test_one_worker_cannot_show_an_overhead(capsys):
    with pytest.raises(SystemExit):
        main(["unit-overhead", "--workers", "1"])
    assert "workers is 1; give at least 2" in capsys.readouterr().err
