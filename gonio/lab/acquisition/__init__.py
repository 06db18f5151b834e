"""From a plan to a measured run: points and steps, exposures, the loop over the steps, the journal and the frames."""
