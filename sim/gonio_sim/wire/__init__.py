"""Wire-level twins: peers on pseudo-terminals and in folders that behave, and misbehave, as the devices do."""
