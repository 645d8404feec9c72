"""The web page: server, feed, scene."""
