"""What every other room speaks.

Value types, the rig model, encoder readings as functions of time, compiled linear algebra, helper processes. No file, no device.
"""
