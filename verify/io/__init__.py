"""Everything read from or written to disk.

Sessions, rig, marker, board, series, video, results; whole-file writes.
"""
