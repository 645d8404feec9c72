"""What a MELFA controller's refusals and alarms mean to whoever wants to move the arm."""

from verify.devices.melfa_lines import ERRORS, RunState

# the slot of EXEC is taken, or holds what cannot be left: clients report these at the first EXEC
SLOT = frozenset({4160, 5100, 5640})


def refused(name: str, error: int) -> str:
    """Word a refusal."""
    said = f"{name} was refused, error {error}: {ERRORS.get(error, 'not known')}"
    if name == "EXEC" and error in SLOT:
        return f"{said}; reset the program at the pendant, or choose another slot"
    return said


def standing_alarm(state: RunState) -> str:
    """Word what STATE tells of an alarm; empty where there is none."""
    if state.error:
        meaning = ERRORS.get(state.error, "not known")
        return f"alarm {state.error} is standing: {meaning}; clear it at the controller"
    return "the emergency stop is pressed" if state.emergency_stop else ""
