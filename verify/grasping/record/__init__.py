"""Film, tables and session of a grab."""
