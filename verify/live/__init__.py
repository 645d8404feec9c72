"""Live monitoring of a moving robot: station, intake, alarms, recording, web page."""
