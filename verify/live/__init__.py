"""A moving robot watched: station, intake, alarms, recording, the web page."""
