"""Progress of a training on a terminal and in a log."""

from dcgrid_env.agents.training.training_loop import progress


def test_progress_on_a_terminal_is_a_bar_with_the_last_figures(monkeypatch, capsys):
    """Iterations without a validation keep them; a resumed training begins where it was."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with progress("[toy6], ppo", 4, 1) as advance:
        advance(2, "J 0.5")
        advance(3)
    said = capsys.readouterr().out
    last = said[said.rindex("[toy6], ppo") :]
    assert " 3/4 " in last
    assert "J 0.5" in last
    assert not said.count("iterations")


def test_the_time_left_excludes_what_an_earlier_process_did(monkeypatch, capsys):
    clock_s = iter((100.0, 110.0))
    monkeypatch.setattr("dcgrid_env.agents.training.training_loop._computing_s", lambda: next(clock_s))
    with progress("toy6, ppo", 100, 50) as advance:
        advance(59)
        advance(60, "J 0.5, droop 0.6")
    assert capsys.readouterr().out == "toy6, ppo: 60 % of 100 iterations, J 0.5, droop 0.6, 0:00:40 left\n"
