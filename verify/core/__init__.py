"""Value types, the rig model, encoder readings as functions of time, compiled linear algebra.

And worker processes. Every other room imports it; it reads no file and no device.
"""
