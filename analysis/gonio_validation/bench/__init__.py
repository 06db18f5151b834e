"""Speed against error of every way of evaluating the models: `gonio bench models`."""
