"""A motion recorded to register the robot by: what it still lacks, terminal, page."""
