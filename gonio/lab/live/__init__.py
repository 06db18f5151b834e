"""Pages that show what happens while it happens: a small server, and what `gonio watch` follows and draws."""
