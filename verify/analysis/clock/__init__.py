"""The offset between the controller's clock and the cameras': from arrivals and from the motion."""
