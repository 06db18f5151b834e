"""The papers' pictures, rendered again from scene files, with verdicts on what the texts say of them."""
