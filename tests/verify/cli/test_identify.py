"""What `verify identify` says on the terminal."""

from verify.cli.identify.sessions import _joint_line


def test_the_terminal_gives_the_u_of_the_report_with_k_2() -> None:
    """Of noise from few recordings, Student's U, which summary.json states, is larger."""
    said = _joint_line(
        {
            "joint": 2, "add_to_reading_deg": -0.2025, "standard_uncertainty_deg": 0.1228,
            "expanded_uncertainty_deg": 0.3089,
        }
    )  # fmt: skip
    assert "encoder less measured +0.20° ± 0.25° (k = 2)" in said
