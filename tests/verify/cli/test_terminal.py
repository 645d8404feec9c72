"""The user's terminal: what it shows while something takes long."""

import pytest

from verify.cli.terminal import Terminal


def test_a_bar_names_a_folder_as_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with Terminal().progress("pairs of monday[red]") as progress:
        progress(1, 2)
    assert "pairs of monday[red]" in capsys.readouterr().err
