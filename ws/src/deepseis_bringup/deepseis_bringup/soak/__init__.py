"""Long runs with random faults: what was lost, what grew."""
