"""Measured poses against encoder readings.

Clock, joint errors, uncertainty, diagnosis, verdict, and the results a report is made of.
"""
