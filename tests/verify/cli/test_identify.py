"""What `verify identify` says on the terminal."""

from verify.cli.identify.sessions import _joint_line


def test_the_terminal_gives_u_with_its_coverage_factor() -> None:
    """Of noise from few recordings, Student's factor is larger than two."""
    said = _joint_line(
        {"joint": 2, "add_to_reading_deg": -0.2025, "expanded_uncertainty_deg": 0.3089}, 2.5157
    )
    assert "encoder less measured +0.20° ± 0.31° (k = 2.52)" in said
    exact = _joint_line(
        {"joint": 2, "add_to_reading_deg": 0.1, "expanded_uncertainty_deg": 0.01}, 2
    )
    assert "(k = 2);" in exact
