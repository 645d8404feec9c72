"""Sessions, devices, boards, a grasping cell and device emulators with known truth."""
