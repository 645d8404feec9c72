"""Value types, rig model, readings, compiled linear algebra and processes that every room uses."""
