"""A moving robot watched: pairs as they come, joint errors a pair, alarms, and who is told.

Nothing in here can command a robot: no driver that moves one is imported.
"""
