"""The parts of `touchnet train`: its options, batches and schedule, and what a run leaves on disk."""
