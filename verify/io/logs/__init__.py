"""Tables of other programs, read into encoders.csv and poses.csv."""
