"""The simulated goniometer: a second rig behind the same interface."""
