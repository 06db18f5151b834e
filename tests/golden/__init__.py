"""What commands wrote and printed once, kept as the net under every change: tests/golden/readme.md."""
