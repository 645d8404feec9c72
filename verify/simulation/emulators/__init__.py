"""Devices that answer on a port."""
