"""Moves of a MELFA controller: orders, dialogue, states."""
