"""The next session before anyone moves: which poses and motion, and what they would show."""
