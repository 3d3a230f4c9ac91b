"""How fast touchnet is beside the best other way of doing the same: `python -m benchmarks`."""
