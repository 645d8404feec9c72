"""The next session designed before anyone moves: poses, motion, what it would show."""
