"""The commands of the laboratory: rig, calibrate, plan, measure, reduce, run."""
