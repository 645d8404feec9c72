"""R3 line protocol and real-time stream, read only."""
