"""A person's hands on a rig: one device at a time, whatever the others do."""
